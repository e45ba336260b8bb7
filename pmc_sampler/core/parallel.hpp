// A small thread pool: run(count, task) calls task(i) for every i < count and returns when all are done. What a task computes
// must depend on i alone, never on the thread that ran it.
#pragma once

#include <atomic>
#include <condition_variable>
#include <exception>
#include <functional>
#include <mutex>
#include <thread>
#include <vector>

namespace pmc {

class ThreadPool {
public:
    // threads counts the caller too; 0 means one for each processor.
    explicit ThreadPool(unsigned threads = 0) : size_(threads ? threads : std::max(1u, std::thread::hardware_concurrency())) {}
    ~ThreadPool() {
        {
            std::lock_guard lock(mutex_);
            stop_ = true;
        }
        wake_.notify_all();
        for (auto& worker : workers_) worker.join();
    }
    ThreadPool(const ThreadPool&) = delete;
    ThreadPool& operator=(const ThreadPool&) = delete;

    unsigned size() const { return size_; }

    template <class Task>
    void run(std::size_t count, Task&& task) {
        if (size_ == 1 || count <= 1) {
            for (std::size_t i = 0; i < count; ++i) task(i);
            return;
        }
        // Threads start with the first work for them: a sampler that is only asked about its settings has none.
        while (workers_.size() + 1 < size_) workers_.emplace_back([this] { work(); });
        const std::function<void(std::size_t)> function = [&task](std::size_t i) { task(i); };
        {
            std::lock_guard lock(mutex_);
            task_ = &function;
            count_ = count;
            next_ = 0;
            error_ = nullptr;
        }
        wake_.notify_all();
        drain(function, count);
        std::unique_lock lock(mutex_);
        task_ = nullptr;  // whoever wakes up only now is not waited for: that takes longer than many a task
        idle_.wait(lock, [this] { return busy_ == 0; });
        if (error_) std::rethrow_exception(error_);
    }

    // task(begin, end) over [0, count) in pieces of at least `grain`, several for each thread so that none waits long.
    template <class Task>
    void ranges(std::size_t count, std::size_t grain, Task&& task) {
        const std::size_t pieces = std::max<std::size_t>(1, std::min(count / std::max<std::size_t>(grain, 1), std::size_t(size_) * 8));
        run(pieces, [&](std::size_t i) { task(count * i / pieces, count * (i + 1) / pieces); });
    }

private:
    void drain(const std::function<void(std::size_t)>& task, std::size_t count) {
        for (std::size_t i; (i = next_.fetch_add(1)) < count;) {
            try {
                task(i);
            } catch (...) {
                std::lock_guard lock(mutex_);
                if (!error_) error_ = std::current_exception();
            }
        }
    }
    void work() {
        std::unique_lock lock(mutex_);
        for (;;) {
            wake_.wait(lock, [this] { return stop_ || (task_ && next_ < count_); });
            if (stop_) return;
            const std::function<void(std::size_t)>* task = task_;
            const std::size_t count = count_;
            ++busy_;
            lock.unlock();
            drain(*task, count);
            lock.lock();
            if (--busy_ == 0) idle_.notify_one();
        }
    }

    unsigned size_;
    std::vector<std::thread> workers_;
    std::mutex mutex_;
    std::condition_variable wake_, idle_;
    const std::function<void(std::size_t)>* task_ = nullptr;
    std::size_t count_ = 0;
    std::atomic<std::size_t> next_{0};
    unsigned busy_ = 0;  // workers at the task
    bool stop_ = false;
    std::exception_ptr error_;
};

}  // namespace pmc
