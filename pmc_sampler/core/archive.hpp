// Saving and restoring by one list of fields (`archive` member templates): named byte blocks, checked for size on the way in.
#pragma once

#include <cstdint>
#include <cstring>
#include <functional>
#include <span>
#include <stdexcept>
#include <string>
#include <vector>

#include "memory.hpp"

namespace pmc {

class Writer {
public:
    using Sink = std::function<void(const std::string&, std::span<const std::byte>)>;
    explicit Writer(Sink sink) : sink_(std::move(sink)) {}
    static constexpr bool reading = false;

    template <class T>
    void value(const std::string& name, const T& v) {
        static_assert(std::is_trivially_copyable_v<T>);
        sink_(name, std::as_bytes(std::span(&v, 1)));
    }
    template <class T>
    void array(const std::string& name, const Zeroed<T>& v) {
        sink_(name, std::as_bytes(std::span(v.data(), v.size())));
    }
    template <class T>
    void vector(const std::string& name, const std::vector<T>& v) {
        sink_(name, std::as_bytes(std::span(v.data(), v.size())));
    }
    template <class T>
    void buffer(const std::string& name, const Buffer<T>& v) {
        sink_(name, std::as_bytes(v.span()));
    }

private:
    Sink sink_;
};

class Reader {
public:
    using Source = std::function<std::span<const std::byte>(const std::string&)>;  // empty where there is no such block
    explicit Reader(Source source) : source_(std::move(source)) {}
    static constexpr bool reading = true;

    template <class T>
    void value(const std::string& name, T& v) {
        static_assert(std::is_trivially_copyable_v<T>);
        copy(name, &v, sizeof(T));
    }
    template <class T>
    void array(const std::string& name, Zeroed<T>& v) {
        copy(name, v.data(), v.size() * sizeof(T));
    }
    template <class T>
    void vector(const std::string& name, std::vector<T>& v) {
        v.resize(count<T>(name));
        copy(name, v.data(), v.size() * sizeof(T));
    }
    template <class T>
    void buffer(const std::string& name, Buffer<T>& v) {
        v.resize(count<T>(name));
        copy(name, v.data(), v.size() * sizeof(T));
    }

private:
    template <class T>
    std::size_t count(const std::string& name) const {
        const std::size_t bytes = source_(name).size();
        if (bytes % sizeof(T)) throw std::runtime_error("checkpoint block '" + name + "' is damaged: " + std::to_string(bytes) + " bytes");
        return bytes / sizeof(T);
    }
    void copy(const std::string& name, void* to, std::size_t bytes) const {
        const auto from = source_(name);
        if (from.size() != bytes)
            throw std::runtime_error("checkpoint block '" + name + "' holds " + std::to_string(from.size()) + " bytes, expected " +
                                     std::to_string(bytes) + ": it is damaged or of another version");
        if (bytes) std::memcpy(to, from.data(), bytes);
    }
    Source source_;
};

}  // namespace pmc
