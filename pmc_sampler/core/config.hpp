// Every setting of the sampler, with its unit, range and equation, and the check of each. "Paper" is Y.-C. Lai and C. Dyer,
// "Population Monte Carlo Path Tracing", University of Wisconsin-Madison CS TR 1614, 2007.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <sstream>
#include <stdexcept>
#include <string>
#include <vector>

namespace pmc {

// How beta, the density from which pixels are drawn, follows from a pixel's n samples of luminance variance var and mean I.
enum class Beta : std::uint8_t {
    gain,      // var / (tvi(I)^2 n^2): the squared perceptual error that one more sample removes; dimensionless
    variance,  // var / tvi(I): the paper's choice (section 4.3.2)
};

// What the image is as an estimate of the true one.
enum class Estimator : std::uint8_t {
    consistent,  // right in the limit: all that was seen steers
    unbiased,    // of the right expectation at every count of samples: see Film::guide()
};

// Pixel reconstruction filter, applied by filter importance sampling (Ernst, Stamminger and Greiner 2006,
// doi:10.1109/RT.2006.280223): a sample counts for one pixel with weight one, and its place is drawn from the filter.
enum class Filter : std::uint8_t { box, tent, gaussian, blackman_harris };

struct Config {
    static constexpr std::uint32_t max_kernels = 3;
    static constexpr double automatic = -1.0;  // of initial_spp: a sixteenth of the budget, 4 to 16

    // The batch
    std::uint64_t batch = 0;        // samples in a batch; 0: see Sampler::batch_size(). Once it adapts, `population` sets the size where given
    double initial_spp = automatic; // samples a pixel from the pool before anything adapts
    double pool_share = 0.15;       // share of each batch from the stratified pool, in [0, 1]
    double direct_share = 0.75;     // share of the rest drawn from beta and evaluated where drawn, in [0, 1]
    std::uint32_t lookahead = 0;    // batch k is drawn from what batches up to k - 1 - lookahead told, in [0, 64]

    // The population (sections 4.1 and 4.3)
    std::uint32_t population = 0;         // members n; 0: what fills the batch
    std::uint32_t moves = 2;              // T_R: kernel moves of a member in each iteration, in [0, 1024]
    std::vector<double> radii;            // d_k: radii of the kernel's disks in pixels, 1 to 3 of them, above 0; none: 0.5, 1.5, 4
    double eliminate = 0.6;               // share of the members replaced in each iteration, in [0, 1]
    double regenerate_pool = 0.0;         // share of the regenerated members placed by the pool, in [0, 1]
    double regenerate_jitter = 0.0;       // regenerated from beta, a member moves up to this far in x and y; pixels, in [0, 64]
    bool evaluate_regenerated = true;     // a regenerated member is evaluated before it moves

    // Adaptation (section 4.3.3)
    std::uint32_t adapt_alpha_every = 10; // iterations, at least 1
    std::uint32_t adapt_beta_every = 1;   // iterations, at least 1
    double alpha_floor = 0.1;             // epsilon in alpha_k = epsilon / K + (1 - epsilon) share_k, in [0, 1]
    double alpha_memory = 0.25;           // how far the remembered alpha moves to a member's, in [0, 1]; 0: members start from equal shares
    Beta beta = Beta::gain;
    double beta_power = 2.0;              // pixels are drawn in proportion to beta to this power, in [0.25, 2]

    // The image
    double white_luminance = 100.0;       // cd/m2 that a radiance luminance of 1.0 stands for, above 0
    Filter filter = Filter::box;
    double filter_radius = 0.5;           // pixels, in (0, 16]; a box of 0.5 is the pixel's own square
    Estimator estimator = Estimator::consistent;  // unbiased: no population and no correction
    double correction = 1.0;              // strength of the energy correction, in [0, 1]; 0 leaves the plain mean
    double correction_sigma = 12.0;       // standard deviation of its smoother in pixels, in [0.5, 256]
    double correction_knee = 0.05;        // luminance, as a share of its surroundings', where it is half applied; in (0, 1]

    std::uint32_t kernels() const { return static_cast<std::uint32_t>(radii.size()); }

    // Checked for an image, and what was left to the sampler filled in. Throws as check() does.
    Config resolved(std::uint32_t width, std::uint32_t height) const {
        check(width, height);
        Config config = *this;
        if (radii.empty())
            for (double radius : {0.5, 1.5, 4.0}) config.radii.push_back(std::min(radius, static_cast<double>(std::max(width, height))));
        if (is_unbiased()) {
            config.direct_share = 1.0;
            config.adapt_beta_every = 1;
            config.correction = 0.0;
        }
        return config;
    }
    bool is_uniform() const { return pool_share == 1.0; }
    bool is_unbiased() const { return estimator == Estimator::unbiased && !is_uniform(); }

    // Throws std::invalid_argument with a sentence that names the setting, what came and what was expected.
    void check() const {
        in_range("initial_spp", initial_spp == automatic ? 0.0 : initial_spp, 0.0, 1e9);
        in_range("pool_share", pool_share, 0.0, 1.0);
        if (is_unbiased() && initial_spp != automatic && initial_spp < 1.0)
            fail("initial_spp", number(initial_spp), "at least 1 for the unbiased estimator, which needs a sample of every pixel from the pool");
        if (is_unbiased() && population > 0)
            throw std::invalid_argument("population is " + std::to_string(population) + ": the unbiased estimator has none, for what it saw in a pixel must not steer there; leave population out");
        in_range("direct_share", direct_share, 0.0, 1.0);
        in_range("lookahead", lookahead, 0, 64);
        in_range("moves", moves, 0, 1024);
        if (radii.size() > max_kernels) throw std::invalid_argument("radii holds " + std::to_string(radii.size()) + " values: expected 1 to 3 radii in pixels");
        for (double radius : radii)
            if (!(radius > 0.0 && radius <= 65536.0)) fail("radii", number(radius), "pixels above 0 and at most 65536");
        in_range("eliminate", eliminate, 0.0, 1.0);
        in_range("regenerate_pool", regenerate_pool, 0.0, 1.0);
        in_range("regenerate_jitter", regenerate_jitter, 0.0, 64.0);
        in_range("adapt_alpha_every", adapt_alpha_every, 1, 1e9);
        in_range("adapt_beta_every", adapt_beta_every, 1, 1e9);
        in_range("alpha_floor", alpha_floor, 0.0, 1.0);
        in_range("alpha_memory", alpha_memory, 0.0, 1.0);
        in_range("beta_power", beta_power, 0.25, 2.0);
        if (!(white_luminance > 0.0 && white_luminance < 1e12))
            fail("white_luminance", number(white_luminance), "cd/m2 above 0 and below 1e12");
        if (!(filter_radius > 0.0 && filter_radius <= 16.0))
            fail("filter_radius", number(filter_radius), "pixels above 0 and at most 16");
        in_range("correction", correction, 0.0, 1.0);
        in_range("correction_sigma", correction_sigma, 0.5, 256.0);
        in_range("correction_knee", correction_knee, 1e-6, 1.0);
        if (population > 0 && moves == 0 && (eliminate == 0.0 || !evaluate_regenerated))
            throw std::invalid_argument(
                "a population that never moves and is never regenerated draws no samples: set moves to at least 1, or "
                "eliminate above 0 with evaluate_regenerated");
        if (population == 0 && moves == 0 && !evaluate_regenerated && direct_share < 1.0)
            throw std::invalid_argument(
                "moves = 0 without evaluate_regenerated draws no samples: set moves to at least 1, or direct_share to 1");
    }

    // The settings that depend on the image; same exceptions.
    void check(std::uint32_t width, std::uint32_t height) const {
        const std::string image = std::to_string(width) + "x" + std::to_string(height);
        if (width < 1 || height < 1 || width > 65535 || height > 65535 || std::uint64_t(width) * height > (1ull << 31))
            throw std::invalid_argument("the image is " + image +
                                        ": expected 1 to 65535 pixels on each side and at most 2^31 in all");
        check();
        if (is_uniform()) return;  // no population, no kernel
        const double largest = std::max(width, height);
        for (double radius : radii)
            if (moves > 0 && radius > largest)
                throw std::invalid_argument("radii holds " + number(radius) + " pixels, beyond the image of " + image +
                                            ": expected at most " + number(largest));
        if (population > std::uint64_t(width) * height)
            throw std::invalid_argument("population is " + std::to_string(population) + ", more than the " +
                                        std::to_string(std::uint64_t(width) * height) + " pixels of the " + image +
                                        " image: choose a smaller population");
    }

private:
    static std::string number(double value) {
        std::ostringstream out;
        out << value;
        return out.str();
    }
    [[noreturn]] static void fail(const std::string& name, const std::string& came, const std::string& expected) {
        throw std::invalid_argument(name + " is " + came + ": expected " + expected);
    }
    static void in_range(const char* name, double value, double low, double high) {
        if (!(value >= low && value <= high)) fail(name, number(value), number(low) + " to " + number(high));
    }
};

// When to stop; whichever limit is met first. The pool is laid out for `spp`.
struct Budget {
    static constexpr double none = std::numeric_limits<double>::infinity();
    double spp = none;            // samples a pixel, met to the sample: round(spp * pixels) samples in all; above 0
    double seconds = none;        // wall-clock seconds from the first ask; above 0
    double visible_noise = -1.0;  // share of pixels that may be unsettled (Film::visible_noise), in (0, 1); -1: no limit

    void check() const {
        if (!(spp == none || (spp > 0.0 && spp <= 1e9))) fail("spp", spp, "samples a pixel above 0 and at most 1e9");
        if (!(seconds > 0.0)) fail("seconds", seconds, "seconds above 0");
        if (visible_noise != -1.0 && !(visible_noise > 0.0 && visible_noise < 1.0))
            fail("visible_noise", visible_noise, "a share of the pixels between 0 and 1");
        if (spp == none && seconds == none && visible_noise == -1.0)
            throw std::invalid_argument("the budget has no limit: give spp, seconds or visible_noise");
    }

private:
    [[noreturn]] static void fail(const char* name, double came, const char* expected) {
        std::ostringstream text;
        text << "budget " << name << " is " << came << ": expected " << expected;
        throw std::invalid_argument(text.str());
    }
};

}  // namespace pmc
