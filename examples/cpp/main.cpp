// Renders the room of scene.hpp with pmc_sampler in C++ alone:  spheres WIDTH HEIGHT SPP OUT.pfm [options]
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <sstream>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include <pmc.hpp>

#include "scene.hpp"

namespace {

using Clock = std::chrono::steady_clock;

struct Options {
    std::uint32_t width = 0, height = 0;
    double spp = 0, reference = 0;
    std::string output;
    std::uint64_t seed = 0;
    unsigned threads = 0;
    bool uniform = false;
};

struct Render {
    std::vector<float> image;  // red, green, blue of each pixel, the top row first
    std::uint64_t samples = 0;
    double renderer = 0, sampler = 0;  // seconds
};

Render render(const Options& options, double spp, std::uint64_t seed, bool uniform) {
    Render result;
    pmc::Budget budget;
    budget.spp = spp;
    pmc::Config config;
    if (uniform) config.pool_share = 1.0;

    pmc::Sampler sampler(options.width, options.height, budget, config, seed, 0, options.threads);
    std::vector<float> radiance;
    auto time = Clock::now();
    const auto lap = [&time](double& seconds) {
        const auto before = std::exchange(time, Clock::now());
        seconds += std::chrono::duration<double>(time - before).count();
    };
    while (sampler.done() == pmc::Done::no) {
        const auto batch = sampler.ask();
        radiance.resize(3 * batch->size());
        lap(result.sampler);
        sampler.threads().ranges(batch->size(), 256, [&](std::size_t first, std::size_t last) {
            for (std::size_t i = first; i < last; ++i) {
                const auto [x, y] = batch->positions[i];
                const scene::Ray ray = scene::camera(x, y, static_cast<float>(options.width), static_cast<float>(options.height));
                // Pair 0 went into the place in the pixel.
                const scene::Vec c = scene::radiance(ray, [&](std::uint32_t k) { return pmc::sobol_pair(batch->scramble[i], batch->index[i], k + 1); });
                radiance[3 * i] = c.x, radiance[3 * i + 1] = c.y, radiance[3 * i + 2] = c.z;
            }
        });
        lap(result.renderer);
        sampler.tell(*batch, radiance);
        lap(result.sampler);
    }
    result.image.resize(3 * sampler.film().tiling.pixels());
    pmc::corrected_mean(sampler.film(), sampler.config, result.image.data(), sampler.threads());
    lap(result.sampler);
    result.samples = sampler.samples();
    return result;
}

// Written beside the output and renamed, so that a file that is there stays whole until the new one is.
std::string beside(const std::string& output) { return output + ".part"; }

// The file to write, where a link leads to; before hours of rendering it is sure that it can be, not after.
std::string checked_output(const std::string& output) {
    namespace fs = std::filesystem;
    const bool exists = fs::exists(output);
    if (output.empty() || (exists && !fs::is_regular_file(output)) || !std::ofstream(beside(output)))
        throw std::invalid_argument("cannot write '" + output + "': expected a file in a folder that exists and takes files");
    fs::remove(beside(output));
    return exists ? fs::canonical(output).string() : output;
}

// Portable float map: rows from the bottom up, little-endian.
void write_pfm(const Options& options, const std::vector<float>& image) {
    std::ofstream file(beside(options.output), std::ios::binary);
    file << "PF\n" << options.width << ' ' << options.height << "\n-1.0\n";
    const std::size_t row = 3 * std::size_t(options.width);
    for (std::size_t y = options.height; y-- > 0;) file.write(reinterpret_cast<const char*>(&image[y * row]), static_cast<std::streamsize>(row * sizeof(float)));
    file.close();
    std::error_code failed;
    if (file) std::filesystem::rename(beside(options.output), options.output, failed);
    if (!file || failed) {
        std::filesystem::remove(beside(options.output), failed);
        throw std::runtime_error("cannot write '" + options.output + "'");
    }
}

// Mean squared error, and that of luminance in units of the just noticeable difference (white at 100 cd/m2).
void compare(const std::vector<float>& test, const std::vector<float>& truth) {
    double mse = 0, visible = 0;
    for (std::size_t i = 0; i < test.size(); i += 3) {
        const double d[3] = {double(test[i]) - truth[i], double(test[i + 1]) - truth[i + 1], double(test[i + 2]) - truth[i + 2]};
        for (double channel : d) mse += channel * channel;
        const double y = 100.0 * pmc::luminance(truth[i], truth[i + 1], truth[i + 2]);
        const double thresholds = 100.0 * pmc::luminance(d[0], d[1], d[2]) / pmc::tvi(y);
        visible += thresholds * thresholds;
    }
    std::printf("mse %.6g\ntvi_error %.6g\n", mse / double(test.size()), visible / (double(test.size()) / 3));
}

double number(const char* text, const char* name, double low, double high) {
    char* end = nullptr;
    const double value = std::strtod(text, &end);
    if (end == text || *end || !(value >= low && value <= high)) {
        std::ostringstream sentence;
        sentence << name << " is '" << text << "': expected a number from " << low << " to " << high;
        throw std::invalid_argument(sentence.str());
    }
    return value;
}

std::uint64_t whole(const char* text, const char* name, double low, double high) {
    const double value = number(text, name, low, high);
    if (value != std::floor(value)) throw std::invalid_argument(std::string(name) + " is '" + text + "': expected a whole number");
    return static_cast<std::uint64_t>(value);
}

constexpr const char* usage =
    "usage: spheres WIDTH HEIGHT SPP OUT.pfm [--uniform] [--seed N] [--threads N] [--reference SPP]\n"
    "  --uniform        the same number of samples for every pixel\n"
    "  --reference SPP  render that, too, uniformly and with another seed, and print the error against it\n";

Options parse(int argc, char** argv) {
    if (argc < 5) throw std::invalid_argument("expected a width, a height, samples a pixel and a file to write");
    Options options;
    options.width = static_cast<std::uint32_t>(whole(argv[1], "WIDTH", 1, 65535));
    options.height = static_cast<std::uint32_t>(whole(argv[2], "HEIGHT", 1, 65535));
    options.spp = number(argv[3], "SPP", 1e-3, 1e6);
    options.output = argv[4];
    for (int i = 5; i < argc; ++i) {
        const std::string name = argv[i];
        const auto value = [&] {
            if (i + 1 == argc) throw std::invalid_argument(name + " expects a number after it");
            return argv[++i];
        };
        if (name == "--uniform") options.uniform = true;
        else if (name == "--seed") options.seed = whole(value(), "--seed", 0, 1e15);
        else if (name == "--threads") options.threads = static_cast<unsigned>(whole(value(), "--threads", 1, 1024));
        else if (name == "--reference") options.reference = number(value(), "--reference", 1, 1e6);
        else throw std::invalid_argument("unknown option '" + name + "'");
    }
    return options;
}

}  // namespace

int main(int argc, char** argv) {
    try {
        for (int i = 1; i < argc; ++i)
            if (argv[i] == std::string("--help") || argv[i] == std::string("-h")) return std::fputs(usage, stdout) < 0;
        Options options = parse(argc, argv);
        options.output = checked_output(options.output);
        const Render result = render(options, options.spp, options.seed, options.uniform);
        write_pfm(options, result.image);
        std::printf("samples %llu\nseconds_renderer %.3f\nseconds_sampler %.3f\n", static_cast<unsigned long long>(result.samples), result.renderer, result.sampler);
        if (options.reference > 0) compare(result.image, render(options, options.reference, options.seed + 0x5eed, true).image);
    } catch (const std::invalid_argument& error) {
        std::fprintf(stderr, "spheres: %s\n%s", error.what(), usage);
        return 2;
    } catch (const std::exception& error) {
        std::fprintf(stderr, "spheres: %s\n", error.what());
        return 1;
    }
}
