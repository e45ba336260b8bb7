"""Measuring samplers and renderers: metrics, images, references, statistics and the benchmark.

Imports :mod:`pmc_sampler` and :mod:`pmc_sampler.scenes`, never an adapter: renderers are handed in as
callables. Needs the packages of the ``eval`` extra (``pip install 'pmc_sampler[eval]'``).
"""
