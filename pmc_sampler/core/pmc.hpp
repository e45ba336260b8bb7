// pmc_sampler for C++ renderers: include this, link threads; C++20, no other dependency.
#pragma once

#include "pictures.hpp"
#include "sampler.hpp"
