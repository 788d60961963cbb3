// Pictures of a MuJoCo scene, drawn off screen by MuJoCo's own OpenGL renderer.
#pragma once

#include <mujoco/mujoco.h>

#include <array>
#include <cstdint>
#include <memory>
#include <mutex>
#include <span>
#include <string>
#include <vector>

#include "rcs/gl_context.hpp"

namespace rcs {

/// How much a picture may cost.
enum class Quality : std::uint8_t {
  fast,  ///< no shadows, reflections, sky or antialiasing, coarse round shapes: for training and data collection
  full,  ///< all of these: for pictures that people look at and for matching real cameras
};

/// What a renderer is made for.
struct RenderOptions {
  Quality quality = Quality::fast;
  int max_width = 640;   ///< pixels; pictures may be smaller
  int max_height = 480;  ///< pixels
  std::string backend = "auto";
  /// Which geom groups are drawn: groups 0 to 2 are what one sees, 3 to 5 hold collision shapes by MuJoCo's custom.
  std::array<bool, mjNGROUP> geom_groups = {true, true, true, false, false, false};
};

/// Where a picture goes. Rows from the top, no gaps between rows.
struct Picture {
  int width = 0;                      ///< pixels
  int height = 0;                     ///< pixels
  std::uint8_t* rgb = nullptr;        ///< height × width × 3
  std::uint16_t* depth_mm = nullptr;  ///< height × width, along the optical axis, 0 = nothing or beyond 65.535 m; may be null
};

/// Draws one scene from its cameras. May be called from any thread: calls wait for each other.
class Renderer {
 public:
  /// `model` must outlive the renderer and is not changed. Throws `std::invalid_argument`, `GlUnavailable`.
  Renderer(const mjModel* model, const RenderOptions& options);
  ~Renderer();
  Renderer(const Renderer&) = delete;
  Renderer& operator=(const Renderer&) = delete;

  /// Take over the poses of `data`, once for all cameras; they must be current (`mj_forward`, or the stages of kinematics).
  void update(mjData* data);
  /// Take over the poses that belong to a row of `mjSTATE_INTEGRATION`.
  void update_from_state(std::span<const double> state);
  /// Draw what camera `camera` sees.
  void render(int camera, const Picture& picture);

  /// Free everything. Closing twice is harmless; any other call afterwards throws `WrongOrder`.
  void close();
  bool is_open() const { return open_ != nullptr; }

  const mjModel* model() const { return model_; }
  const RenderOptions& options() const { return options_; }
  /// Length of a state row.
  int state_size() const { return state_size_; }
  /// Backend, renderer and version in one line.
  std::string description() const;
  /// Throws `std::invalid_argument` when there is no such camera or the picture does not fit.
  void check(int camera, const Picture& picture) const;

 private:
  struct Open;
  Open& require_open(const char* call) const;

  const mjModel* model_;
  RenderOptions options_;
  int state_size_;
  std::unique_ptr<Open> open_;
  mutable std::mutex mutex_;
};

}  // namespace rcs
