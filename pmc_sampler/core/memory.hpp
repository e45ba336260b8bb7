// Storage without initialisation beyond zeros.
#pragma once

#include <cstddef>
#include <cstdlib>
#include <limits>
#include <memory>
#include <new>
#include <span>
#include <type_traits>
#include <utility>

// AddressSanitizer sees what comes from the heap alone.
#if defined(__has_feature)
#if __has_feature(address_sanitizer)
#define __SANITIZE_ADDRESS__ 1
#endif
#endif
#if defined(__linux__) && !defined(__SANITIZE_ADDRESS__)
#define PMC_HUGE_PAGES 1
#include <sys/mman.h>
#include <unistd.h>
#else
#define PMC_HUGE_PAGES 0
#endif

namespace pmc {

// Bytes of any value, or zeros that begin with a cache line. A large block asks for huge pages, where the system has them (Linux):
// the film is larger than the caches, samples jump about in it, and with pages of 4 KiB the translation of addresses, and above all
// the first touch of every page, cost as much as what is computed.
class Block {
public:
    Block() = default;
    Block(std::size_t bytes, bool zeroed) {
#if PMC_HUGE_PAGES
        if (bytes >= huge / 2) {
            const std::size_t whole = (bytes + huge - 1) / huge * huge;  // the rest of the last page, too, or it would be small ones
            mapped_ = whole + huge;
            block_ = mmap(nullptr, mapped_, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
            if (block_ == MAP_FAILED) throw std::bad_alloc();
            data_ = align(huge, whole, mapped_);
            // Not for what may only be touched here and there: a film larger than the memory. Where it is refused, small pages do.
            if (bytes <= physical() / 8) madvise(data_, whole, MADV_HUGEPAGE);
            return;
        }
#endif
        block_ = zeroed ? std::calloc(bytes + line, 1) : std::malloc(bytes);
        if (!block_ && (zeroed || bytes)) throw std::bad_alloc();
        data_ = zeroed ? align(line, bytes, bytes + line) : block_;
    }
    Block(Block&& other) noexcept { swap(other); }
    Block& operator=(Block&& other) noexcept {
        Block old;
        old.swap(*this);
        swap(other);
        return *this;
    }
    ~Block() {
#if PMC_HUGE_PAGES
        if (mapped_) {
            munmap(block_, mapped_);
            return;
        }
#endif
        std::free(block_);
    }
    void* data() const { return data_; }

private:
    static constexpr std::size_t line = 64;
    static constexpr std::size_t huge = std::size_t(2) << 20;

#if PMC_HUGE_PAGES
    static std::size_t physical() {  // bytes of the machine's memory
        static const std::size_t bytes = static_cast<std::size_t>(sysconf(_SC_PHYS_PAGES)) * static_cast<std::size_t>(sysconf(_SC_PAGESIZE));
        return bytes;
    }
#endif
    void* align(std::size_t alignment, std::size_t bytes, std::size_t room) const {
        void* start = block_;
        return std::align(alignment, bytes, start, room);
    }
    void swap(Block& other) {
        std::swap(block_, other.block_);
        std::swap(data_, other.data_);
        std::swap(mapped_, other.mapped_);
    }

    void *block_ = nullptr, *data_ = nullptr;
    std::size_t mapped_ = 0;
};

// The bytes of so many elements; throws where no memory could hold them.
template <class T>
std::size_t bytes_of(std::size_t size) {
    if (size > static_cast<std::size_t>(std::numeric_limits<std::ptrdiff_t>::max()) / sizeof(T)) throw std::bad_array_new_length();
    return size * sizeof(T);
}

// Fixed-size zeroed storage. A large film costs its memory only where samples fall: pages come into being when they are touched.
template <class T>
class Zeroed {
    static_assert(std::is_trivially_copyable_v<T>);

public:
    explicit Zeroed(std::size_t size) : size_(size), block_(bytes_of<T>(size), true) {}
    Zeroed(const Zeroed&) = delete;
    Zeroed& operator=(const Zeroed&) = delete;
    T& operator[](std::size_t i) { return data()[i]; }
    const T& operator[](std::size_t i) const { return data()[i]; }
    std::size_t size() const { return size_; }
    T* data() { return static_cast<T*>(block_.data()); }
    const T* data() const { return static_cast<const T*>(block_.data()); }

private:
    const std::size_t size_;
    const Block block_;
};

// A growing buffer whose new elements are not initialised: batches are overwritten whole, so zeroing them is wasted time. What is in it
// is lost when it grows.
template <class T>
class Buffer {
    static_assert(std::is_trivially_copyable_v<T>);

public:
    Buffer() = default;
    Buffer(Buffer&& other) noexcept { *this = std::move(other); }
    Buffer& operator=(Buffer&& other) noexcept {
        size_ = std::exchange(other.size_, 0);
        capacity_ = std::exchange(other.capacity_, 0);
        block_ = std::move(other.block_);
        return *this;
    }
    void resize(std::size_t size) {
        if (size > capacity_) allocate(size);
        size_ = size;
    }
    // The same for what is filled anew: it does not hold on to the memory of a much larger use.
    void renew(std::size_t size) {
        if (size > capacity_ || 4 * size < capacity_) allocate(size);
        size_ = size;
    }
    T& operator[](std::size_t i) { return data()[i]; }
    const T& operator[](std::size_t i) const { return data()[i]; }
    std::size_t size() const { return size_; }
    T* data() { return static_cast<T*>(block_.data()); }
    const T* data() const { return static_cast<const T*>(block_.data()); }
    std::span<const T> span() const { return {data(), size_}; }

private:
    void allocate(std::size_t size) {
        size_ = capacity_ = 0;
        block_ = Block();  // before there are two
        block_ = Block(bytes_of<T>(size), false);
        capacity_ = size;
    }

    std::size_t size_ = 0, capacity_ = 0;
    Block block_;
};

}  // namespace pmc
