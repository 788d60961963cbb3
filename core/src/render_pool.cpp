#include "rcs/render_pool.hpp"

#include <pthread.h>

#include <atomic>
#include <condition_variable>
#include <exception>
#include <mutex>
#include <stdexcept>
#include <string>
#include <thread>

#include "fork.hpp"
#include "rcs/result.hpp"
#include "trap.hpp"

namespace rcs {

/// The work of one call of `render_states`. Threads take rows until none is left.
struct RenderPool::Job {
  std::span<const double> states;
  std::span<const Film> films;
  mjBatch* batch = nullptr;
  std::size_t rows = 0;
  std::atomic<std::size_t> next_row = 0;
  std::mutex mutex{};  // guards the error and the batch, whose calls do not say that they may overlap
  std::exception_ptr error{};
};

/// The threads and what they draw with.
struct RenderPool::Studio {
  std::vector<Painter> painters;  // the first one is the calling thread's
  std::vector<std::thread> workers;
  std::mutex calls;  // held through each call and `close`

  std::mutex mutex;  // guards all below
  std::condition_variable started;
  std::condition_variable finished;
  Job* job = nullptr;
  std::uint64_t job_number = 0;  // tells a new job from the one just done
  int busy = 0;                  // workers that have not finished the job
  bool is_ending = false;

  void serve(RenderPool& pool, Painter& painter);
};

RenderPool::RenderPool(const mjModel* model, int threads, const RenderOptions& options)
    : model_(model), threads_(threads), forks_(forks()), studio_(std::make_unique<Studio>()) {
  if (threads < 1 || threads > kMostThreads)
    throw std::invalid_argument("render pool: " + std::to_string(threads) + " threads were asked for, valid is 1 to " +
                                std::to_string(kMostThreads));
  for (int i = 0; i < threads; ++i) studio_->painters.push_back({std::make_unique<Renderer>(model, options), nullptr});
  state_size_ = studio_->painters.front().renderer->state_size();
  description_ = studio_->painters.front().renderer->description();
  try {
    for (int i = 1; i < threads; ++i) {
      std::thread& worker = studio_->workers.emplace_back([this, i] { studio_->serve(*this, studio_->painters[i]); });
      pthread_setname_np(worker.native_handle(), ("rcs-render-" + std::to_string(i)).c_str());
    }
  } catch (...) {
    close();  // those that have started wait for work
    throw;
  }
}

RenderPool::~RenderPool() { close(); }

bool RenderPool::is_forked() const { return threads_ > 1 && forks_ != forks(); }

void RenderPool::close() {
  if (is_forked()) {
    // The threads are in the parent process: to wait for them, or for what they hold, would last for ever.
    is_open_ = false;
    static_cast<void>(studio_.release());
    return;
  }
  const std::lock_guard call(studio_->calls);
  is_open_ = false;
  {
    const std::lock_guard lock(studio_->mutex);
    studio_->is_ending = true;
  }
  studio_->started.notify_all();
  for (std::thread& worker : studio_->workers) worker.join();
  studio_->workers.clear();
  studio_->painters.clear();
}

void RenderPool::render_states(std::span<const double> states, std::span<const Film> films, mjBatch* batch) {
  if (is_forked())
    throw WrongOrder(
        "render pool: render_states was called after a fork, and the threads of this pool are in the parent process; "
        "make the pool in the child, or start the child with \"spawn\"");
  Studio& studio = *studio_;
  const std::lock_guard call(studio.calls);
  if (!is_open()) throw WrongOrder("render pool: render_states was called after close(); make a new pool");
  if (states.size() % static_cast<std::size_t>(state_size_) != 0)
    throw std::invalid_argument("render pool: rows of states must have " + std::to_string(state_size_) + " numbers");
  if (states.empty()) return;
  for (const Film& film : films) studio.painters.front().renderer->check(film.camera, film.picture(0));

  const std::size_t rows = states.size() / static_cast<std::size_t>(state_size_);
  if (batch != nullptr && rows != static_cast<std::size_t>(mjb_nsim(batch)))
    throw std::invalid_argument("render pool: " + std::to_string(rows) + " states were given, the batch has " +
                                std::to_string(mjb_nsim(batch)) + " simulations");
  if (batch != nullptr && mjb_model(batch)->nbuffer != model_->nbuffer)
    throw std::invalid_argument("render pool: the batch's model is another one than the pool's");
  Job job{.states = states, .films = films, .batch = batch, .rows = rows};
  {
    const std::lock_guard lock(studio.mutex);
    studio.job = &job;
    ++studio.job_number;
    studio.busy = static_cast<int>(studio.workers.size());
  }
  studio.started.notify_all();
  work(studio.painters.front(), job);
  {
    std::unique_lock lock(studio.mutex);
    studio.finished.wait(lock, [&studio] { return studio.busy == 0; });
    studio.job = nullptr;
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
        if (!painter.model) trapped("render pool", [&] { painter.model.reset(mj_copyModel(nullptr, model_)); });
        {
          const std::lock_guard lock(job.mutex);
          trapped("render pool", [&] { mjb_getModel(job.batch, static_cast<int>(row), painter.model.get()); });
        }
        renderer.update_from_state(state, painter.model.get());
      }
      for (const Film& film : job.films) renderer.render(film.camera, film.picture(row));
    }
  } catch (...) {
    const std::lock_guard lock(job.mutex);
    if (!job.error) job.error = std::current_exception();
    job.next_row = job.rows;
  }
}

void RenderPool::Studio::serve(RenderPool& pool, Painter& painter) {
  std::uint64_t done = 0;
  std::unique_lock lock(mutex);
  while (true) {
    started.wait(lock, [&] { return is_ending || job_number != done; });
    if (is_ending) return;
    done = job_number;
    Job& now = *job;
    lock.unlock();
    pool.work(painter, now);
    lock.lock();
    if (--busy == 0) finished.notify_one();
  }
}

}  // namespace rcs
