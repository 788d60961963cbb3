#include "rcs/camera.hpp"

#include <utility>

#include "rcs/result.hpp"

namespace rcs {

Camera::Camera(std::string name, CameraMode mode) : life_(std::move(name)), mode_(mode) {
  if (mode.width < 1 || mode.height < 1 || !(mode.fps > 0.0))
    throw InvalidSetup(life_.name() + ": width, height and fps must be positive");
}

void Camera::open() {
  if (life_.is_open()) return;
  do_open();
  life_.open();
}

Frame Camera::read() {
  life_.require_ready("read");
  Frame frame = do_read();
  const auto pixels = static_cast<std::size_t>(mode_.width) * static_cast<std::size_t>(mode_.height);
  if (frame.rgb.size() != 3 * pixels || frame.depth_mm.size() != (mode_.has_depth ? pixels : 0)) {
    set_fault("a frame has " + std::to_string(frame.rgb.size()) + " colour bytes and " +
              std::to_string(frame.depth_mm.size()) + " depth pixels, which is not the size of the camera's mode");
    throw DeviceFault(name() + ": " + fault());
  }
  return frame;
}

void Camera::set_fault(const std::string& reason) { life_.set_fault(reason); }

void Camera::recover() {
  life_.require_open("recover");
  do_recover();
  life_.clear_fault();
}

void Camera::close() {
  if (!life_.is_open()) return;
  life_.close();
  do_close();
}

}  // namespace rcs
