// The thread pool, on its own threads and on others'.
#include <algorithm>
#include <atomic>
#include <cfenv>
#include <chrono>
#include <functional>
#include <memory>
#include <new>
#include <stdexcept>
#include <thread>
#include <utility>
#include <vector>

#include <parallel.hpp>

#include "arithmetic.hpp"
#include "piece.hpp"

#if defined(__linux__)
#include <cerrno>
#include <dlfcn.h>
#include <pthread.h>

// The system's, as often as is granted.
static std::atomic<int> threads_granted{1 << 20};
extern "C" int pthread_create(pthread_t* thread, const pthread_attr_t* attributes, void* (*start)(void*), void* data) {
    if (threads_granted-- <= 0) return EAGAIN;
    static const auto next = reinterpret_cast<decltype(&pthread_create)>(dlsym(RTLD_NEXT, "pthread_create"));
    return next(thread, attributes, start, data);
}
#endif

namespace {

// Executors keep or break the state of arithmetic of whoever calls a task.
class InCaller : public pmc::Executor {
public:
    unsigned size() const override { return 4; }
    void submit(unsigned calls, std::function<void(unsigned thread)> call) override {
        const bool was = is_unusual();
        for (unsigned t = calls; t-- > 0;) {
            call(0);
            kept &= is_unusual() == was;
        }
    }

    bool kept = true;  // the state of arithmetic
};

class OnUnusualThreads : public pmc::Executor {
public:
    ~OnUnusualThreads() override { join(); }
    unsigned size() const override { return 3; }
    void submit(unsigned calls, std::function<void(unsigned thread)> call) override {
        if (threads_.size() > 100) join();
        for (unsigned t = 0; t < calls; ++t) {
            threads_.emplace_back([=, this] {
                make_unusual();
                call(5 * t + 2);
                if (!is_unusual()) kept = false;
            });
        }
    }

    std::atomic<bool> kept{true};

private:
    void join() {
        for (std::thread& thread : threads_) thread.join();
        threads_.clear();
    }
    std::vector<std::thread> threads_;
};

// Its calls are made when it is told to: when all is done, or when the pool is no more.
class Late : public pmc::Executor {
public:
    unsigned size() const override { return 3; }
    void submit(unsigned calls, std::function<void(unsigned thread)> call) override {
        for (unsigned t = 1; t <= calls; ++t) waiting_.emplace_back([=] { call(t); });
    }
    std::size_t come() {
        for (const auto& call : waiting_) call();
        return std::exchange(waiting_, {}).size();
    }

private:
    std::vector<std::function<void()>> waiting_;
};

class Refusing : public pmc::Executor {
public:
    unsigned size() const override { return 2; }
    void submit(unsigned, std::function<void(unsigned thread)>) override {
        if (below(2)) throw std::bad_alloc();
        throw 1;
    }
};

using Calls = std::vector<std::atomic<unsigned>>;

bool all_once(const Calls& calls) {
    return std::all_of(calls.begin(), calls.end(), [](const auto& n) { return n == 1; });
}

// Some tasks take longer than others.
void call(Calls& calls, std::size_t i) {
    if (i % 13 == 5) std::this_thread::yield();
    ++calls.at(i);
}

void each_once(pmc::ThreadPool& pool, std::size_t count) {
    Calls calls(count), in_ranges(count);
    pool.run(count, [&](std::size_t i) { call(calls, i); });
    require(all_once(calls), "each index is called once");
    const std::size_t grain = below(2) ? 1 : below(300);
    std::atomic<std::size_t> pieces{0};
    pool.ranges(count, grain, [&](std::size_t first, std::size_t last) {
        ++pieces;
        require(last - first >= std::min(grain, count), "no range is smaller than it is to be");
        for (std::size_t i = first; i < last; ++i) call(in_ranges, i);
    });
    require(all_once(in_ranges), "each index is in one range");
    require(pieces <= std::max<std::size_t>(1, 8 * pool.size()), "there are several ranges for each thread, not many");
}

struct Thrown : std::runtime_error {
    explicit Thrown(std::size_t i) : std::runtime_error(at + ": thrown by task " + std::to_string(i)), i(i) {}
    std::size_t i;
};

// Every `step`-th task from `first` on throws.
void throwing(pmc::ThreadPool& pool, std::size_t count, std::size_t first, std::size_t step) {
    Calls calls(count);
    const auto throws = [&](std::size_t i) { return i >= first && (i - first) % step == 0; };
    try {
        pool.run(count, [&](std::size_t i) {
            call(calls, i);
            if (throws(i)) throw Thrown{i};
        });
        require(false, "an exception reaches the caller");
    } catch (const Thrown& thrown) {
        require(throws(thrown.i), "an exception is a task's own");
    }
    if (pool.size() > 1)
        require(all_once(calls), "all tasks are called though some throw");
    else  // nobody else goes on
        for (std::size_t i = 0; i < count; ++i) require(calls[i] == (i <= first), "a single thread stops where it throws");
}

// Each of two tasks waits for the other: no thread does both. The caller then waits for the other's, for so long that it may sleep.
void at_once(pmc::ThreadPool& pool) {
    const std::thread::id caller = std::this_thread::get_id();
    std::atomic<int> here{0}, done{0};
    pool.run(2, [&](std::size_t) {
        ++here;
        while (here < 2) std::this_thread::yield();
        if (std::this_thread::get_id() != caller) std::this_thread::sleep_for(std::chrono::milliseconds(5));
        ++done;
    });
    require(done == 2, "a run ends after its tasks");
}

void drive(pmc::ThreadPool& pool, const std::string& name, int rounds) {
    for (int k = 0; k < rounds; ++k) {
        for (const bool awake : {false, true}) {
            std::unique_ptr<pmc::ThreadPool::Awake> lives;
            if (awake) lives = std::make_unique<pmc::ThreadPool::Awake>(pool);
            for (const std::size_t count : {0, 1, 2, 1000}) {
                at = name + (awake ? ", awake, " : ", ") + std::to_string(count) + " tasks, round " + std::to_string(k);
                each_once(pool, count);
                if (count == 0) continue;
                throwing(pool, count, below(static_cast<std::uint32_t>(count)), 1 + below(static_cast<std::uint32_t>(count)));
                each_once(pool, count);
            }
        }
    }
}

void test() {
    for (const unsigned threads : {1u, 2u, 16u}) {
        pmc::ThreadPool pool(threads);
        require(pool.size() == threads, "a pool has the threads that were asked for");
        drive(pool, std::to_string(threads) + " threads", 15);
        for (const bool awake : {false, true}) {
            if (threads == 1) continue;
            at = std::to_string(threads) + " threads that slept" + (awake ? ", awake" : "");
            std::this_thread::sleep_for(std::chrono::milliseconds(5));
            std::unique_ptr<pmc::ThreadPool::Awake> lives;
            if (awake) lives = std::make_unique<pmc::ThreadPool::Awake>(pool);
            at_once(pool);
        }
    }
    // Threads that go to sleep while their pool ends: 100,000 pools met with a wake-up that was lost, had there been one.
    for (int k = 0; k < 2000; ++k) {
        pmc::ThreadPool pool(1 + below(4));
        at = "pool " + std::to_string(k) + " of " + std::to_string(pool.size());
        if (below(2)) each_once(pool, below(100));
    }
#if defined(__linux__)
    pmc::ThreadPool refused(4);
    threads_granted = 0;
    drive(refused, "threads that the system refuses", 5);
    threads_granted = 1;
    for (int k = 0; k < 5; ++k) {
        at = "the one thread that the system grants, run " + std::to_string(k);
        at_once(refused);
        std::this_thread::sleep_for(std::chrono::milliseconds(2));  // until it sleeps
    }
    threads_granted = 1 << 20;
    drive(refused, "threads that the system refused until now", 5);
    at_once(refused);
#endif
    const auto others = std::make_shared<OnUnusualThreads>();
    pmc::ThreadPool on_threads((pmc::Threads(others)));
    require(on_threads.size() == others->size(), "a pool is as large as its executor");
    drive(on_threads, "others' threads", 5);
    at_once(on_threads);
    const auto caller = std::make_shared<InCaller>();
    pmc::ThreadPool in_caller((pmc::Threads(caller)));
    drive(in_caller, "an executor in the caller", 15);
    const auto refusing = std::make_shared<Refusing>();
    pmc::ThreadPool alone((pmc::Threads(refusing)));
    drive(alone, "an executor that refuses", 5);
    const auto late = std::make_shared<Late>();
    auto left_alone = std::make_unique<pmc::ThreadPool>(pmc::Threads(late));
    drive(*left_alone, "threads that come late", 5);
    require(late->come() > 0, "threads are called for");
    each_once(*left_alone, 100);
    left_alone.reset();
    require(late->come() > 0, "threads are called for");

    std::fenv_t before;
    std::fegetenv(&before);
    for (const bool unusual : {false, true}) {
        pmc::ThreadPool own(2), single(1);
        for (pmc::ThreadPool* pool : {&on_threads, &in_caller, &own, &single}) {
            at = std::string(pool == &in_caller ? "in the caller" : pool == &on_threads ? "on others' threads" : pool == &own ? "on its own threads" : "on one thread") + (unusual ? ", whose arithmetic is unusual" : "");
            if (unusual) make_unusual();
            std::atomic<int> right{0};
            pool->run(100, [&](std::size_t) { right += is_usual(); });
            const bool kept = unusual ? is_unusual() : is_usual();
            std::fesetenv(&before);
            require(right == 100, "a task computes with denormal numbers and rounds to the nearest");
            require(kept && others->kept && caller->kept, "the state of arithmetic is the thread's own again");
        }
    }
}

}  // namespace

int main() { return report(test); }
