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
class Camera {
 public:
  Camera(std::string name, CameraMode mode);
  virtual ~Camera() = default;
  Camera(const Camera&) = delete;
  Camera& operator=(const Camera&) = delete;

  const std::string& name() const { return life_.name(); }
  const CameraMode& mode() const { return mode_; }
  bool is_open() const { return life_.is_open(); }
  const std::string& fault() const { return life_.fault(); }

  void open();
  /// The newest frame. Throws `DeviceFault` when its size is not that of the mode.
  Frame read();
  void set_fault(const std::string& reason);
  void recover();
  void close();

 protected:
  virtual void do_open() {}
  virtual Frame do_read() = 0;
  virtual void do_recover() {}
  virtual void do_close() {}

 private:
  Lifecycle life_;
  CameraMode mode_;
};

}  // namespace rcs
