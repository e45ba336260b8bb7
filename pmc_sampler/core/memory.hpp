// Fixed-size zeroed storage. calloc hands out untouched zero pages, so a large film costs its memory only where samples fall.
#pragma once

#include <cstddef>
#include <cstdlib>
#include <memory>
#include <new>
#include <span>
#include <type_traits>

namespace pmc {

template <class T>
class Zeroed {
    static_assert(std::is_trivially_copyable_v<T>);

public:
    explicit Zeroed(std::size_t size) : size_(size), block_(std::calloc(size * sizeof(T) + line, 1)) {
        if (!block_) throw std::bad_alloc();
        void* start = block_.get();
        std::size_t room = size * sizeof(T) + line;
        data_ = static_cast<T*>(std::align(line, size * sizeof(T), start, room));
    }
    T& operator[](std::size_t i) { return data_[i]; }
    const T& operator[](std::size_t i) const { return data_[i]; }
    std::size_t size() const { return size_; }
    T* data() { return data_; }
    const T* data() const { return data_; }

private:
    static constexpr std::size_t line = 64;  // elements of 64 bytes then lie in one cache line each
    struct Free {
        void operator()(void* p) const { std::free(p); }
    };
    std::size_t size_;
    std::unique_ptr<void, Free> block_;
    T* data_;
};

// A growing buffer whose new elements are not initialised: batches are overwritten whole, so zeroing them is wasted time.
template <class T>
class Buffer {
    static_assert(std::is_trivially_copyable_v<T>);

public:
    void resize(std::size_t size) {
        if (size > capacity_) {
            data_ = std::make_unique_for_overwrite<T[]>(size);
            capacity_ = size;
        }
        size_ = size;
    }
    T& operator[](std::size_t i) { return data_[i]; }
    const T& operator[](std::size_t i) const { return data_[i]; }
    std::size_t size() const { return size_; }
    T* data() { return data_.get(); }
    const T* data() const { return data_.get(); }
    std::span<const T> span() const { return {data_.get(), size_}; }

private:
    std::size_t size_ = 0, capacity_ = 0;
    std::unique_ptr<T[]> data_;
};

}  // namespace pmc
