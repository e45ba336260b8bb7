// The threads of nanothread, which are those of Dr.Jit and so of Mitsuba, by the addresses of its functions: the library is the
// renderer's own, and nothing here is linked with it.
#pragma once

#include <cstdint>

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
        void (*task_wait_and_release)(void* task);
    };
    explicit Nanothread(const Functions& functions) : functions_(functions) {}

    unsigned size() const override { return functions_.pool_size(nullptr); }
    void run(unsigned calls, void (*task)(unsigned thread, void* data), void* data) override {
        struct Payload {
            void (*task)(unsigned, void*);
            void* data;
            std::uint32_t (*thread)();
        } payload{task, data, functions_.pool_thread_id};
        const auto call = [](std::uint32_t, void* p) {
            const auto& payload = *static_cast<Payload*>(p);
            payload.task(payload.thread(), payload.data);
        };
        // The payload is copied. The caller works along while it waits.
        functions_.task_wait_and_release(functions_.task_submit_dep(nullptr, nullptr, 0, calls, call, &payload, sizeof(payload), nullptr, 0, 0));
    }

private:
    Functions functions_;
};

}  // namespace pmc
