// Cameras of all copies of a world as learners want their pictures: drawn by the threads that step, written in place.
#pragma once

#include <mujoco/mujoco.h>

#include <cstdint>
#include <memory>
#include <mutex>
#include <span>
#include <string>
#include <vector>

#include "rcs/renderer.hpp"
#include "rcs/watcher.hpp"

namespace rcs {

struct Backdrop;

/// The change of a stack of frames when its copy is shown.
enum class FrameUse : std::uint8_t {
  keep,     ///< what it was
  advance,  ///< the frames move up, and the newest is added
  start,    ///< the newest frame in every place, as at the start of an episode
  replace,  ///< the newest frame in the place of the last newest
};

/// The use of each camera's frames.
struct PixelLayout {
  bool is_grayscale = false;  ///< one channel, luma as in ITU-R BT.601, instead of red, green, blue
  int stack = 1;              ///< frames that an observation has, the newest last
};

/// One camera.
struct PixelCamera {
  int camera = 0;              ///< in the model
  int width = 0;               ///< pixels
  int height = 0;              ///< pixels
  const Lens* lens = nullptr;  ///< as in `Picture`
};

/// Draws cameras of a world's copies into arrays copies × (stack · channels) × height × width.
///
/// Pictures of quality `fast` are drawn without OpenGL where the scene has only what that can draw (no textures, soft
/// bodies, height fields): it takes a fifth to a half of the time, needs no OpenGL, and looks the same but for
/// rounding. Others are those of a `Renderer`.
class PixelCameras : public Watcher {
 public:
  /// `model` must outlive it. `threads` is how many draw at once. Throws `std::invalid_argument`, `GlUnavailable`.
  PixelCameras(const mjModel* model, int copies, int threads, std::vector<PixelCamera> cameras, PixelLayout layout,
               const RenderOptions& options);
  ~PixelCameras() override;

  /// The place of the next frames, and that of those of the last step, one array for each camera. From null, every
  /// stack starts with the newest frame. Forgets which copies were drawn.
  void turn(std::vector<std::uint8_t*> to, std::vector<const std::uint8_t*> from);
  /// True if a copy was drawn in a step since the last `turn`, for each copy.
  const std::vector<std::uint8_t>& drawn() const { return drawn_; }
  /// True if there are frames of the step before.
  bool can_keep() const { return !to_.empty() && !from_.empty(); }
  /// Fill the arrays of a copy with its frames of the step before.
  void keep(int copy);
  /// The task of `see` for each copy.
  void set_uses(std::span<const FrameUse> uses);

  void see_step(const mjModel* model, mjData* data, int copy) override;
  void see(const mjModel* model, mjData* data, int copy) override;
  void check(const mjModel* model, int copies) const override;

  std::size_t camera_count() const { return cameras_.size(); }
  int copies() const { return static_cast<int>(drawn_.size()); }
  int channels() const { return (layout_.is_grayscale ? 1 : 3) * layout_.stack; }
  const PixelCamera& camera(std::size_t number) const { return cameras_[number]; }
  bool uses_opengl() const { return !why_opengl_.empty(); }
  /// Why OpenGL draws; empty if it does not.
  const std::string& why_opengl() const { return why_opengl_; }

 private:
  struct Painter;
  class Borrowed;
  struct Place {
    std::uint8_t* to;
    const std::uint8_t* from;
    std::size_t frame;  // bytes
  };
  Place place(std::size_t camera, int copy) const;
  void draw(const mjModel* model, mjData* data, int copy, FrameUse use);
  void paint(Painter& painter, const PixelCamera& camera, Backdrop* backdrop, std::uint8_t* out) const;

  std::uint64_t signature_;  // of the model
  std::vector<PixelCamera> cameras_;
  PixelLayout layout_;
  std::string why_opengl_;
  std::vector<std::uint8_t*> to_;
  std::vector<const std::uint8_t*> from_;
  std::vector<std::uint8_t> drawn_;
  std::vector<FrameUse> uses_;
  std::mutex mutex_;  // guards the painters that are free
  std::vector<std::unique_ptr<Painter>> painters_;
  std::vector<Painter*> free_;
};

}  // namespace rcs
