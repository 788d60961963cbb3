#include "rcs/camera.hpp"

#include <utility>

#include "rcs/result.hpp"

namespace rcs {

Camera::Camera(std::string name, CameraMode mode) : Device(std::move(name)), mode_(mode) {
  if (mode.width < 1 || mode.height < 1 || !(mode.fps > 0.0))
    throw InvalidSetup(this->name() + ": width, height and fps must be positive");
}

Frame Camera::read() {
  require_ready("read");
  Frame frame = do_read();
  const auto pixels = static_cast<std::size_t>(mode_.width) * static_cast<std::size_t>(mode_.height);
  if (frame.rgb.size() != 3 * pixels || frame.depth_mm.size() != (mode_.has_depth ? pixels : 0))
    fail("a frame has " + std::to_string(frame.rgb.size()) + " colour bytes and " +
         std::to_string(frame.depth_mm.size()) + " depth pixels, which is not the size of the camera's mode");
  return frame;
}

}  // namespace rcs
