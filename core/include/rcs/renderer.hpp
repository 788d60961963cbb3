// Pictures of a MuJoCo scene, drawn off screen by MuJoCo's own OpenGL renderer.
#pragma once

#include <mujoco/mujoco.h>

#include <array>
#include <atomic>
#include <cstdint>
#include <memory>
#include <mutex>
#include <span>
#include <string>

#include "rcs/gl_context.hpp"
#include "rcs/lens.hpp"

namespace rcs {

/// How much a picture may cost.
enum class Quality : std::uint8_t {
  fast,  ///< no shadows, reflections, sky, haze or antialiasing, coarse round shapes: for training and collecting data
  full,  ///< all of these: for pictures that people look at and for matching real cameras
};

/// The purpose of a renderer.
struct RenderOptions {
  Quality quality = Quality::fast;
  int max_width = 640;   ///< pixels; pictures may be smaller
  int max_height = 480;  ///< pixels
  /// "auto", "egl" or "osmesa", see `GlContext`.
  std::string backend = "auto";
  /// Which groups of geoms are drawn. By custom 0 to 2 hold what one sees, 3 to 5 collision shapes.
  std::array<bool, mjNGROUP> geom_groups = {true, true, true, false, false, false};
  /// Draw colours without OpenGL at quality `fast`, where the scene allows it and OpenGL has no graphics card; depth
  /// and ids are drawn with it. Colours look the same but for rounding, in less than half of the time.
  bool is_rasterised = false;
};

/// The memory of a picture. Rows start at the top, with no gaps between them.
struct Picture {
  int width = 0;                ///< pixels
  int height = 0;               ///< pixels
  std::uint8_t* rgb = nullptr;  ///< height × width × 3
  /// height × width, distance along the optical axis, of transparent geoms as of others; 0 where nothing is or it is
  /// beyond 65.535 m. Null: not wanted.
  std::uint16_t* depth_mm = nullptr;
  /// height × width, what each pixel shows: 0 nothing, otherwise 1 + the number of a geom, or of a flex, a skin or a
  /// tendon, which are counted on in this order. Transparent geoms are among them. Null: not wanted.
  std::uint16_t* ids = nullptr;
  /// How the camera is calibrated. Null: as in the model.
  const Lens* lens = nullptr;
};

/// Throws `std::invalid_argument` when the model has no such camera or the picture does not fit.
void check_picture(const mjModel& model, const RenderOptions& options, int camera, const Picture& picture);

/// Draws one scene as seen by the cameras of its model. Calls may come from any thread; they wait for each other.
///
/// Geoms, skins, flexes and tendons are drawn; sites and other decoration, which no real camera sees, are not.
class Renderer {
 public:
  /// `model` must outlive the renderer and is never changed. Throws `std::invalid_argument`, `GlUnavailable`, and like
  /// all that draw `SimulationError` with MuJoCo's words.
  Renderer(const mjModel* model, const RenderOptions& options);
  ~Renderer();
  Renderer(const Renderer&) = delete;
  Renderer& operator=(const Renderer&) = delete;

  /// Take over the poses in `data`, which is of the renderer's model, once for all cameras. They must be current: after
  /// `mj_forward`, or after `mj_kinematics`, `mj_comPos` and `mj_camlight` (without the last one cameras and lights are
  /// where they were).
  void update(mjData* data);
  /// Take over the poses that follow from a row of `mjSTATE_INTEGRATION`, which has `state_size()` numbers.
  void update_from_state(std::span<const double> state);
  /// The same with colours, lights, cameras and shapes of `model`, which has the sizes, meshes and textures of the
  /// renderer's own.
  void update_from_state(std::span<const double> state, const mjModel* model);
  /// Take over the poses in `data`, as in the first `update`, with the looks of `model`.
  void update(const mjModel* model, mjData* data);
  /// Draw what camera `camera` sees. Its intrinsics are those of the model, stretched to the picture's aspect ratio
  /// only if it has a sensor size (MuJoCo's `sensorsize`); a camera with `fovy` has square pixels.
  void render(int camera, const Picture& picture);
  /// Throws `std::invalid_argument` when there is no such camera or the picture does not fit.
  void check(int camera, const Picture& picture) const;

  /// Free everything. Closing twice is harmless; drawing afterwards throws `WrongOrder`.
  void close();
  bool is_open() const { return is_open_.load(); }

  const RenderOptions& options() const { return options_; }
  int state_size() const { return state_size_; }
  /// Backend, renderer and OpenGL version in one line.
  const std::string& description() const { return description_; }

 private:
  struct Open;
  Open& require_open(const char* call) const;
  void show(Open& open, int camera, const Picture& picture) const;
  void prepare(Open& open, int width, int height) const;
  void draw_ids(Open& open, float* depth) const;
  void rasterise(Open& open, int camera, const Picture& picture) const;

  const mjModel* model_;
  RenderOptions options_;
  int state_size_;
  std::string description_;
  std::atomic<bool> is_open_ = true;
  std::unique_ptr<Open> open_;
  std::mutex mutex_;  // guards what `open_` points to
};

}  // namespace rcs
