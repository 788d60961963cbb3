// Pictures of many states of one scene at once, on several threads.
#pragma once

#include <mujoco/mjbatch.h>
#include <mujoco/mujoco.h>

#include <atomic>
#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "rcs/renderer.hpp"

namespace rcs {

/// One camera's pictures of all states, one after the other.
struct Film {
  int camera = 0;
  int width = 0;                      ///< pixels
  int height = 0;                     ///< pixels
  std::uint8_t* rgb = nullptr;        ///< states × height × width × 3
  std::uint16_t* depth_mm = nullptr;  ///< states × height × width, as in `Picture`; null: not wanted
  std::uint16_t* ids = nullptr;       ///< the same
  const Lens* lens = nullptr;         ///< as in `Picture`

  /// That of one state.
  Picture picture(std::size_t state) const {
    const std::size_t offset = state * static_cast<std::size_t>(width) * height;
    const auto shifted = [offset](std::uint16_t* values) { return values == nullptr ? nullptr : values + offset; };
    return {width, height, rgb == nullptr ? nullptr : rgb + 3 * offset, shifted(depth_mm), shifted(ids), lens};
  }
};

/// Renderers that share out the states of a call. The pictures are those of a single `Renderer`, bit for bit.
///
/// The calling thread is one of the threads, so a pool of one starts none. Calls wait for each other.
class RenderPool {
 public:
  /// Each thread has an OpenGL context of its own; where memory for one is missing, OpenGL ends the process.
  static constexpr int kMostThreads = 64;

  /// `model` must outlive the pool. Throws `std::invalid_argument`, `GlUnavailable`, `std::system_error` when a thread
  /// cannot start.
  RenderPool(const mjModel* model, int threads, const RenderOptions& options);
  ~RenderPool();
  RenderPool(const RenderPool&) = delete;
  RenderPool& operator=(const RenderPool&) = delete;

  /// Draw each row of `states` (count × `state_size()`, rows of `mjSTATE_INTEGRATION`) with each film's camera.
  /// With a batch, row i has the colours, lights, cameras and shapes of its simulation i: for batches with fields of
  /// the model per simulation. Its model must have the sizes, meshes and textures of the pool's.
  void render_states(std::span<const double> states, std::span<const Film> films, mjBatch* batch = nullptr);

  /// End the threads and free everything. Closing twice is harmless; drawing afterwards throws `WrongOrder`, and so
  /// does drawing after a fork, which has not copied the threads.
  void close();
  bool is_open() const { return is_open_.load(); }

  int threads() const { return threads_; }
  int state_size() const { return state_size_; }
  const std::string& description() const { return description_; }

 private:
  struct Job;
  struct FreeModel {
    void operator()(mjModel* model) const { mj_deleteModel(model); }
  };
  /// The tools of one drawing thread.
  struct Painter {
    std::unique_ptr<Renderer> renderer;
    std::unique_ptr<mjModel, FreeModel> model;  // of the copy at work, made when models first differ
  };
  struct Studio;
  bool is_forked() const;
  void work(Painter& painter, Job& job);

  const mjModel* model_;
  int threads_;
  int state_size_ = 0;
  std::string description_;
  std::atomic<bool> is_open_ = true;
  unsigned forks_;
  std::unique_ptr<Studio> studio_;
};

}  // namespace rcs
