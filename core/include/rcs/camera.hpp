// The interface of a camera.
#pragma once

#include <array>
#include <cstdint>
#include <limits>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "rcs/device.hpp"

namespace rcs {

/// The images of a camera, and their size.
struct CameraMode {
  int width = 0;           ///< pixels
  int height = 0;          ///< pixels
  double fps = 0.0;        ///< frames per second
  bool has_depth = false;  ///< whether frames carry depth
};

/// How a camera maps directions to pixels.
struct CameraCalibration {
  std::array<double, 9> matrix{};    ///< px, 3 × 3 by rows; the centre of the top left pixel is (0, 0), as in OpenCV
  std::vector<double> distortion{};  ///< OpenCV's coefficients; empty without distortion
};

/// Pixels that nobody changes any more, so that all copies of a frame share them.
template <typename T>
using Pixels = std::shared_ptr<const T[]>;

/// Make pixels of values, without a copy.
template <typename T>
Pixels<T> share(std::vector<T> values) {
  const auto owner = std::make_shared<const std::vector<T>>(std::move(values));
  return {owner, owner->data()};
}

/// The number of a frame whose driver gave none.
inline constexpr std::uint64_t kUncounted = std::numeric_limits<std::uint64_t>::max();

/// One picture. Copies of a frame share the pixels.
struct Frame {
  int width = 0;                      ///< pixels
  int height = 0;                     ///< pixels
  Pixels<std::uint8_t> rgb{};         ///< height × width × 3, rows from the top
  Pixels<std::uint16_t> depth_mm{};   ///< height × width, 0 = no reading; null without depth
  std::uint64_t number = kUncounted;  ///< counts frames of the device, so that repeats and gaps can be seen; required
  double time = kNaN;                 ///< s, when the picture was taken, on the host's monotonic clock
  double device_time = kNaN;          ///< s, the same on the device's own clock; NaN when it has none
};

/// One camera. An implementation overrides the `do_` functions; users call the others.
class RCS_API Camera : public Device {
 public:
  Camera(std::string name, CameraMode mode, int built_for = kInterfaceVersion);

  const CameraMode& mode() const { return mode_; }
  /// Nothing when it is unknown, which may be so until the camera is open.
  std::optional<CameraCalibration> calibration() {
    return driven("calibration", [this] { return do_calibration(); });
  }

  /// The newest frame. A frame whose driver gives no time has that at which its number was first read. Throws
  /// `DeviceFault` when its size is not that of the mode, when it has no number, and when it is from the future.
  Frame read();

  bool moves() const override { return false; }

 protected:
  virtual Frame do_read() = 0;
  virtual std::optional<CameraCalibration> do_calibration() { return {}; }

 private:
  CameraMode mode_;
  std::optional<std::uint64_t> last_number_;
  double last_time_ = kNaN;
};

}  // namespace rcs
