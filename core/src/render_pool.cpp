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
  mjBatch* batch = nullptr;
  std::size_t rows = 0;
  std::atomic<std::size_t> next_row = 0;
  std::mutex mutex{};  // guards the error and the batch, whose calls do not say that they may overlap
  std::exception_ptr error{};
};

RenderPool::RenderPool(const mjModel* model, int threads, const RenderOptions& options)
    : model_(model), threads_(threads) {
  if (threads < 1)
    throw std::invalid_argument("render pool: " + std::to_string(threads) +
                                " threads were asked for, at least 1 is needed");
  for (int i = 0; i < threads; ++i) painters_.push_back({std::make_unique<Renderer>(model, options), nullptr});
  state_size_ = painters_.front().renderer->state_size();
  description_ = painters_.front().renderer->description();
  for (int i = 1; i < threads; ++i) {
    std::thread& worker = workers_.emplace_back([this, i] { serve(painters_[i]); });
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
  painters_.clear();
}

void RenderPool::render_states(std::span<const double> states, std::span<const Film> films, mjBatch* batch) {
  const std::lock_guard call(calls_);
  if (!is_open()) throw WrongOrder("render pool: render_states was called after close(); make a new pool");
  if (states.size() % static_cast<std::size_t>(state_size_) != 0)
    throw std::invalid_argument("render pool: rows of states must have " + std::to_string(state_size_) + " numbers");
  if (states.empty()) return;
  for (const Film& film : films)
    painters_.front().renderer->check(film.camera, {film.width, film.height, film.rgb, film.depth_mm});

  const std::size_t rows = states.size() / static_cast<std::size_t>(state_size_);
  if (batch != nullptr && rows != static_cast<std::size_t>(mjb_nsim(batch)))
    throw std::invalid_argument("render pool: " + std::to_string(rows) + " states were given, the batch has " +
                                std::to_string(mjb_nsim(batch)) + " simulations");
  if (batch != nullptr && mjb_model(batch)->nbuffer != model_->nbuffer)
    throw std::invalid_argument("render pool: the batch's model is another one than the pool's");
  Job job{.states = states, .films = films, .batch = batch, .rows = rows};
  {
    const std::lock_guard lock(mutex_);
    job_ = &job;
    ++job_number_;
    busy_ = static_cast<int>(workers_.size());
  }
  started_.notify_all();
  work(painters_.front(), job);
  {
    std::unique_lock lock(mutex_);
    finished_.wait(lock, [this] { return busy_ == 0; });
    job_ = nullptr;
  }
  if (job.error) std::rethrow_exception(job.error);
}

void RenderPool::work(Painter& painter, Job& job) {
  Renderer& renderer = *painter.renderer;
  try {
    for (std::size_t row = job.next_row++; row < job.rows; row = job.next_row++) {
      const auto state = job.states.subspan(row * static_cast<std::size_t>(state_size_), state_size_);
      if (job.batch == nullptr) {
        renderer.update_from_state(state);
      } else {
        if (!painter.model) painter.model.reset(mj_copyModel(nullptr, model_));
        {
          const std::lock_guard lock(job.mutex);
          mjb_getModel(job.batch, static_cast<int>(row), painter.model.get());
        }
        renderer.update_from_state(state, painter.model.get());
      }
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

void RenderPool::serve(Painter& painter) {
  std::uint64_t done = 0;
  std::unique_lock lock(mutex_);
  while (true) {
    started_.wait(lock, [&] { return is_ending_ || job_number_ != done; });
    if (is_ending_) return;
    done = job_number_;
    Job& job = *job_;
    lock.unlock();
    work(painter, job);
    lock.lock();
    if (--busy_ == 0) finished_.notify_one();
  }
}

}  // namespace rcs
