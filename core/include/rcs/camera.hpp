// The interface of a camera.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "rcs/device.hpp"

namespace rcs {

/// What a camera delivers, and at what size.
struct CameraMode {
  int width = 0;           ///< pixels
  int height = 0;          ///< pixels
  double fps = 0.0;        ///< frames per second
  bool has_depth = false;  ///< whether frames carry depth
};

/// One picture.
struct Frame {
  std::vector<std::uint8_t> rgb;        ///< height × width × 3, rows from the top
  std::vector<std::uint16_t> depth_mm;  ///< height × width, 0 = no reading; empty without depth
  double time = 0.0;                    ///< s, when the picture was taken, on the device's own monotonic clock
  std::uint64_t number = 0;             ///< counts frames of the device, so that repeats and gaps can be seen
};

/// One camera. An implementation overrides the `do_` functions; users call the others.
class Camera : public Device {
 public:
  Camera(std::string name, CameraMode mode);

  const CameraMode& mode() const { return mode_; }

  /// The newest frame. Throws `DeviceFault` when its size is not that of the mode.
  Frame read();

 protected:
  virtual Frame do_read() = 0;

 private:
  CameraMode mode_;
};

}  // namespace rcs
