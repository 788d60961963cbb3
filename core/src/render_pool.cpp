#include "rcs/render_pool.hpp"

#include <pthread.h>

#include <atomic>
#include <exception>
#include <stdexcept>
#include <string>

#include "rcs/result.hpp"

namespace rcs {

/// What one call of `render_states` asks for. Threads take rows until none is left.
struct RenderPool::Job {
  std::span<const double> states;
  std::span<const Film> films;
  std::size_t rows = 0;
  std::atomic<std::size_t> next_row = 0;
  std::mutex mutex{};  // guards the error
  std::exception_ptr error{};
};

RenderPool::RenderPool(const mjModel* model, int threads, const RenderOptions& options) : threads_(threads) {
  if (threads < 1)
    throw std::invalid_argument("render pool: " + std::to_string(threads) +
                                " threads were asked for, at least 1 is needed");
  for (int i = 0; i < threads; ++i) renderers_.push_back(std::make_unique<Renderer>(model, options));
  state_size_ = renderers_.front()->state_size();
  description_ = renderers_.front()->description();
  for (int i = 1; i < threads; ++i) {
    std::thread& worker = workers_.emplace_back([this, i] { serve(*renderers_[i]); });
    pthread_setname_np(worker.native_handle(), ("rcs-render-" + std::to_string(i)).c_str());
  }
}

RenderPool::~RenderPool() { close(); }

void RenderPool::close() {
  const std::lock_guard call(calls_);
  {
    const std::lock_guard lock(mutex_);
    is_ending_ = true;
  }
  started_.notify_all();
  for (std::thread& worker : workers_) worker.join();
  workers_.clear();
  renderers_.clear();
}

void RenderPool::render_states(std::span<const double> states, std::span<const Film> films) {
  const std::lock_guard call(calls_);
  if (!is_open()) throw WrongOrder("render pool: render_states was called after close(); make a new pool");
  if (states.size() % static_cast<std::size_t>(state_size_) != 0)
    throw std::invalid_argument("render pool: rows of states must have " + std::to_string(state_size_) + " numbers");
  if (states.empty()) return;
  for (const Film& film : films)
    renderers_.front()->check(film.camera, {film.width, film.height, film.rgb, film.depth_mm});

  Job job{.states = states, .films = films, .rows = states.size() / static_cast<std::size_t>(state_size_)};
  {
    const std::lock_guard lock(mutex_);
    job_ = &job;
    ++job_number_;
    busy_ = static_cast<int>(workers_.size());
  }
  started_.notify_all();
  work(*renderers_.front(), job);
  {
    std::unique_lock lock(mutex_);
    finished_.wait(lock, [this] { return busy_ == 0; });
    job_ = nullptr;
  }
  if (job.error) std::rethrow_exception(job.error);
}

void RenderPool::work(Renderer& renderer, Job& job) {
  try {
    for (std::size_t row = job.next_row++; row < job.rows; row = job.next_row++) {
      renderer.update_from_state(job.states.subspan(row * static_cast<std::size_t>(state_size_), state_size_));
      for (const Film& film : job.films) {
        const std::size_t offset = row * static_cast<std::size_t>(film.width) * film.height;
        renderer.render(film.camera, {film.width, film.height, film.rgb + 3 * offset,
                                      film.depth_mm == nullptr ? nullptr : film.depth_mm + offset});
      }
    }
  } catch (...) {
    const std::lock_guard lock(job.mutex);
    if (!job.error) job.error = std::current_exception();
    job.next_row = job.rows;
  }
}

void RenderPool::serve(Renderer& renderer) {
  std::uint64_t done = 0;
  std::unique_lock lock(mutex_);
  while (true) {
    started_.wait(lock, [&] { return is_ending_ || job_number_ != done; });
    if (is_ending_) return;
    done = job_number_;
    Job& job = *job_;
    lock.unlock();
    work(renderer, job);
    lock.lock();
    if (--busy_ == 0) finished_.notify_one();
  }
}

}  // namespace rcs
