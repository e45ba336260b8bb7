// The threads of nanothread, which are those of Dr.Jit and so of Mitsuba, by the addresses of its functions: the library is the
// renderer's own, and nothing here is linked with it.
#pragma once

#include <cstdint>
#include <functional>
#include <utility>

#include "parallel.hpp"

namespace pmc {

class Nanothread : public Executor {
public:
    // As nanothread.h declares them; a pool of null is the one that all of Dr.Jit uses.
    struct Functions {
        std::uint32_t (*pool_size)(void* pool);
        std::uint32_t (*pool_thread_id)();
        void* (*task_submit_dep)(void* pool, const void* const* parents, std::uint32_t parent_count, std::uint32_t size, void (*call)(std::uint32_t, void*), void* payload,
                                 std::uint32_t payload_size, void (*payload_deleter)(void*), int always_async, int profile);
        void (*task_release)(void* task);
    };
    explicit Nanothread(const Functions& functions) : functions_(functions) {}

    unsigned size() const override { return functions_.pool_size(nullptr); }
    void submit(unsigned calls, std::function<void(unsigned thread)> call) override {
        struct Payload {
            std::function<void(unsigned)> call;
            std::uint32_t (*thread)();
        };
        const auto run = [](std::uint32_t, void* p) {
            const auto& payload = *static_cast<Payload*>(p);
            payload.call(payload.thread());
        };
        const auto drop = [](void* p) { delete static_cast<Payload*>(p); };  // after the last call
        constexpr int asynchronous = 1;
        functions_.task_release(functions_.task_submit_dep(nullptr, nullptr, 0, calls, run, new Payload{std::move(call), functions_.pool_thread_id}, 0, drop, asynchronous, 0));
    }

private:
    Functions functions_;
};

}  // namespace pmc
