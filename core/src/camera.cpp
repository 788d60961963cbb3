#include "rcs/camera.hpp"

#include <cmath>

#include "rcs/result.hpp"

namespace rcs {

namespace {
std::string describe(int width, int height, bool has_depth) {
  return std::to_string(width) + " x " + std::to_string(height) + (has_depth ? " with depth" : " without depth");
}
}  // namespace

Camera::Camera(std::string name, CameraMode mode, int built_for) : Device(std::move(name), built_for), mode_(mode) {
  if (mode.width < 1 || mode.height < 1 || !(mode.fps > 0.0))
    throw InvalidSetup(this->name() + ": width, height and fps must be positive");
}

Frame Camera::read() {
  require_ready("read");
  Frame frame = driven("read", [this] { return do_read(); });
  const bool has_depth = frame.depth_mm != nullptr;
  if (!frame.rgb || frame.width != mode_.width || frame.height != mode_.height || has_depth != mode_.has_depth)
    fail("a frame is " + describe(frame.width, frame.height, has_depth) + ", the camera's mode is " +
         describe(mode_.width, mode_.height, mode_.has_depth));
  if (frame.number == kUncounted)
    fail(
        "a frame has no number; count the frames of the device, so that a picture that comes again is not taken for a "
        "new one");
  require_past("a frame", frame.time);
  if (std::isnan(frame.time)) frame.time = frame.number == last_number_ ? last_time_ : monotonic_time();
  last_number_ = frame.number;
  last_time_ = frame.time;
  return frame;
}

}  // namespace rcs
