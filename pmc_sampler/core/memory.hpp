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
    explicit Zeroed(std::size_t size) : size_(size), data_(static_cast<T*>(std::calloc(size ? size : 1, sizeof(T)))) {
        if (!data_) throw std::bad_alloc();
    }
    T& operator[](std::size_t i) { return data_.get()[i]; }
    const T& operator[](std::size_t i) const { return data_.get()[i]; }
    std::size_t size() const { return size_; }
    T* data() { return data_.get(); }
    const T* data() const { return data_.get(); }
    std::span<T> span() { return {data_.get(), size_}; }

private:
    struct Free {
        void operator()(T* p) const { std::free(p); }
    };
    std::size_t size_;
    std::unique_ptr<T, Free> data_;
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
    std::span<T> span() { return {data_.get(), size_}; }
    std::span<const T> span() const { return {data_.get(), size_}; }

private:
    std::size_t size_ = 0, capacity_ = 0;
    std::unique_ptr<T[]> data_;
};

}  // namespace pmc
