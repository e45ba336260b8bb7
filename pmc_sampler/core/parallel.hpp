// A small thread pool: run(count, task) calls task(i) for every i < count and returns when all are done. What a task computes
// must depend on i alone, never on the thread that ran it.
#pragma once

#include <algorithm>
#include <atomic>
#include <cfenv>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <exception>
#include <functional>
#include <limits>
#include <memory>
#include <mutex>
#include <thread>
#include <utility>
#include <vector>

namespace pmc {

// Threads of somebody else, such as a renderer's: those that wait for its next work, spinning, would stand in the way of ours.
class Executor {
public:
    virtual ~Executor() = default;
    virtual unsigned size() const = 0;  // threads, the caller's included
    // Has call(thread) called up to `calls` times, as soon as other threads are free, and returns at once: nobody depends on whether
    // and when. `thread` tells those that call it apart, below size() if it can. Where it throws, nothing is called.
    virtual void submit(unsigned calls, std::function<void(unsigned thread)> call) = 0;
};

// How many threads of its own a pool is to have, the caller's included, 0 for one on each processor; or whose it is to use.
struct Threads {
    Threads(unsigned count = 0) : count(count) {}
    Threads(std::shared_ptr<Executor> executor) : executor(std::move(executor)) {}

    unsigned count = 0;
    std::shared_ptr<Executor> executor;
};

// The usual state of floating-point arithmetic as long as one lives: others' threads may treat denormal numbers as zeros.
class UsualArithmetic {
public:
    UsualArithmetic() {
        std::fegetenv(&before_);
        std::fesetenv(FE_DFL_ENV);
    }
    ~UsualArithmetic() { std::fesetenv(&before_); }
    UsualArithmetic(const UsualArithmetic&) = delete;
    UsualArithmetic& operator=(const UsualArithmetic&) = delete;

private:
    std::fenv_t before_;
};

// What is run now, for those who help with it: some come when it is done, or when whoever wanted it is no more.
class Work {
public:
    using Task = std::function<void(std::size_t)>;

    explicit Work(unsigned threads) : shares_(threads) {}

    // Calls task(i) for every i < count, and returns when all are done; the first exception is thrown then. call_for_help() is called
    // before the caller begins. Without help it is done all the same, so that it may throw.
    template <class CallForHelp>
    void run(std::size_t count, const Task& task, CallForHelp&& call_for_help) {
        for (std::size_t t = 0; t < shares_.size(); ++t) {
            shares_[t].next = count * t / shares_.size();
            shares_[t].end = count * (t + 1) / shares_.size();
        }
        ++runs_;
        task_ = &task;
        try {
            call_for_help();
        } catch (...) {
        }
        drain(task, 0);
        task_ = nullptr;  // whoever comes only now is not waited for
        for (unsigned busy; (busy = busy_) != 0;)
            if (!spin([this] { return busy_ == 0; })) busy_.wait(busy);
        if (error_) std::rethrow_exception(std::exchange(error_, nullptr));
    }

    // Takes part in what is run, unless it did already (`helped`); false where there is nothing to do. The task lives until no thread
    // is busy: one that counts itself in before it looks for the task finds either one that waits for it, or none.
    bool help(unsigned thread, std::uint64_t& helped) {
        if (!task_ || runs_ == helped) return false;
        ++busy_;
        if (const Task* task = task_) {
            const UsualArithmetic usual;
            helped = runs_;
            drain(*task, thread);
        }
        if (--busy_ == 0) busy_.notify_one();
        return true;
    }

private:
    // What each thread begins with: the same part of the whole in every run, so that what it wrote is still in its caches. Who is
    // done with it goes on with the others'.
    struct alignas(64) Share {
        std::atomic<std::size_t> next{0};
        std::size_t end = 0;
    };

    void drain(const Task& task, unsigned thread) {
        for (std::size_t k = 0; k < shares_.size(); ++k) {
            Share& share = shares_[(thread + k) % shares_.size()];
            for (std::size_t i; (i = share.next++) < share.end;) {
                try {
                    task(i);
                } catch (...) {
                    const std::lock_guard lock(mutex_);
                    if (!error_) error_ = std::current_exception();
                }
            }
        }
    }
    // Whether something becomes so shortly.
    template <class Condition>
    static bool spin(Condition&& condition) {
        for (int i = 0; i < 200; ++i) {
            if (condition()) return true;
            std::this_thread::yield();
        }
        return false;
    }

    std::vector<Share> shares_;
    std::atomic<const Task*> task_{nullptr};
    std::atomic<std::uint64_t> runs_{0};
    std::atomic<unsigned> busy_{0};  // threads at the task, the caller's not among them
    std::mutex mutex_;
    std::exception_ptr error_;
};

class ThreadPool {
public:
    explicit ThreadPool(Threads threads = {})
        : executor_(std::move(threads.executor)),
          size_(std::max(1u, executor_ ? executor_->size() : threads.count ? threads.count : std::thread::hardware_concurrency())),
          work_(std::make_shared<Work>(size_)) {}
    ~ThreadPool() {
        stop_ = true;
        wake();
        for (auto& worker : workers_) worker.join();
    }
    ThreadPool(const ThreadPool&) = delete;
    ThreadPool& operator=(const ThreadPool&) = delete;

    unsigned size() const { return size_; }

    // As long as one lives, and shortly after, the threads wait on their feet: many a task takes less time than waking up does, and
    // one that is called while it goes to sleep may end up on the processor of its caller. Nobody is to wait for others meanwhile,
    // such as the renderer, which needs the processors itself.
    class Awake {
    public:
        explicit Awake(ThreadPool& threads) : threads_(threads) {
            threads_.awake_until_ = std::numeric_limits<Clock::rep>::max();
            threads_.wake();
        }
        ~Awake() { threads_.awake_until_ = (Clock::now() + std::chrono::microseconds(50)).time_since_epoch().count(); }
        Awake(const Awake&) = delete;
        Awake& operator=(const Awake&) = delete;

    private:
        ThreadPool& threads_;
    };

    // Arithmetic is the usual in all tasks, whatever it is in the caller.
    template <class Task>
    void run(std::size_t count, Task&& task) {
        const UsualArithmetic usual;
        if (size_ == 1 || count <= 1) {
            for (std::size_t i = 0; i < count; ++i) task(i);
            return;
        }
        work_->run(count, [&task](std::size_t i) { task(i); }, [this] { call_for_help(); });
    }

    // The same, and calls beside() meanwhile, on one thread.
    template <class Task, class Beside>
    void run(std::size_t count, Task&& task, Beside&& beside) {
        run(count + 1, [&](std::size_t i) {
            if (i == 0)
                beside();
            else
                task(i - 1);
        });
    }

    // task(begin, end) over [0, count) in pieces of at least `grain`, several for each thread so that none waits long.
    template <class Task>
    void ranges(std::size_t count, std::size_t grain, Task&& task) {
        const std::size_t pieces = std::max<std::size_t>(1, std::min(count / std::max<std::size_t>(grain, 1), std::size_t(size_) * 8));
        run(pieces, [&](std::size_t i) { task(count * i / pieces, count * (i + 1) / pieces); });
    }

private:
    using Clock = std::chrono::steady_clock;

    void call_for_help() {
        if (executor_) {
            executor_->submit(size_ - 1, [work = work_](unsigned thread) {
                std::uint64_t helped = 0;
                work->help(thread, helped);
            });
            return;
        }
        if (awake_until_ != std::numeric_limits<Clock::rep>::max()) wake();
        // Threads start with the first work for them: a sampler that is only asked about its settings has none. Where the system
        // refuses one, those that there are, which are called already, do its work.
        while (workers_.size() + 1 < size_) workers_.emplace_back([this, thread = static_cast<unsigned>(workers_.size()) + 1] { serve(thread); });
    }
    void serve(unsigned thread) {
        std::uint64_t helped = 0;
        for (;;) {
            const std::uint32_t before = calls_;  // read first: a call that comes after it ends the wait below at once
            if (stop_) return;
            if (work_->help(thread, helped)) continue;
            if (Clock::now().time_since_epoch().count() < awake_until_)
                std::this_thread::yield();
            else
                calls_.wait(before);
        }
    }
    void wake() {
        ++calls_;
        calls_.notify_all();
    }

    std::shared_ptr<Executor> executor_;
    unsigned size_;
    std::shared_ptr<Work> work_;
    std::vector<std::thread> workers_;
    std::atomic<std::uint32_t> calls_{0};  // how often sleeping threads were called
    std::atomic<Clock::rep> awake_until_{0};
    std::atomic<bool> stop_{false};
};

}  // namespace pmc
