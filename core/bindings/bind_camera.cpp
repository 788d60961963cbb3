// Camera: the interface that delivers frames.
#include <nanobind/nanobind.h>
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <optional>

#include "overrides.hpp"
#include "rcs/camera.hpp"
#include "rcs/result.hpp"

using namespace nb::literals;

namespace {

using Rgb = In<const std::uint8_t, nb::shape<-1, -1, 3>, nb::c_contig, nb::device::cpu>;
using Depth = In<const std::uint16_t, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using Matrix = In<const double, nb::shape<3, 3>, nb::c_contig, nb::device::cpu>;

struct PyCamera : PyDevice<rcs::Camera> {
  using PyDevice::PyDevice;
  rcs::Frame do_read() override { return call<rcs::Frame>("_read", "a Frame"); }
  std::optional<rcs::CameraCalibration> do_calibration() override {
    using Calibration = std::optional<rcs::CameraCalibration>;
    return call_or("_calibration", "a CameraCalibration or None", Calibration());
  }
};

/// The pixels of an array, which lives as long as they do.
template <typename T, typename Form>
rcs::Pixels<T> share_array(const Form& array) {
  return {array.data(), [array](const T*) {}};
}

rcs::Frame make_frame(const Rgb& rgb, const std::optional<Depth>& depth, std::uint64_t number, double time,
                      double device_time) {
  if (depth && (depth->shape(0) != rgb.shape(0) || depth->shape(1) != rgb.shape(1)))
    throw rcs::InvalidSetup("A frame needs colours and depth of one size, (H, W, 3) and (H, W).");
  return {static_cast<int>(rgb.shape(1)),
          static_cast<int>(rgb.shape(0)),
          share_array<std::uint8_t>(rgb),
          depth ? share_array<std::uint16_t>(*depth) : nullptr,
          number,
          time,
          device_time};
}

rcs::CameraCalibration make_calibration(const Matrix& matrix, std::vector<double> distortion) {
  rcs::CameraCalibration calibration{{}, std::move(distortion)};
  std::copy_n(matrix.data(), 9, calibration.matrix.begin());
  return calibration;
}

}  // namespace

void bind_camera(nb::module_& m) {
  using rcs::Camera, rcs::CameraCalibration, rcs::CameraMode, rcs::Frame;
  nb::class_<CameraMode>(m, "CameraMode", "Mode of a camera: what it delivers, and at what size.")
      .def(nb::init<int, int, double, bool>(), "width"_a, "height"_a, "fps"_a, "has_depth"_a = false)
      .def_ro("width", &CameraMode::width, "Pixels.")
      .def_ro("height", &CameraMode::height, "Pixels.")
      .def_ro("fps", &CameraMode::fps, "Frames per second.")
      .def_ro("has_depth", &CameraMode::has_depth);

  nb::class_<CameraCalibration> calibration(m, "CameraCalibration", "How a camera maps directions to pixels.");
  calibration
      .def(
          "__init__",
          [](CameraCalibration* self, const Matrix& matrix, std::vector<double> distortion) {
            new (self) CameraCalibration(make_calibration(matrix, std::move(distortion)));
          },
          "matrix"_a, "distortion"_a = std::vector<double>())
      .def_prop_ro(
          "matrix", [](const CameraCalibration& c) { return to_array(c.matrix, {3, 3}); }, nb::rv_policy::move,
          "Camera matrix K [px], (3, 3); the centre of the top left pixel is (0, 0), as in OpenCV.");
  def_array(calibration, "distortion", &CameraCalibration::distortion,
            "OpenCV's distortion coefficients, (n,); empty without distortion.");

  nb::class_<Frame> frame(m, "Frame", "One picture. Its arrays are read-only views of memory that all copies share.");
  frame
      .def(
          "__init__",
          [](Frame* self, const Rgb& rgb, const std::optional<Depth>& depth_mm, std::uint64_t number, double time,
             double device_time) { new (self) Frame(make_frame(rgb, depth_mm, number, time, device_time)); },
          "rgb"_a, "depth_mm"_a = nb::none(), nb::kw_only(), "number"_a, "time"_a = rcs::kNaN,
          "device_time"_a = rcs::kNaN,
          "Make a frame of rgb (H, W, 3) uint8 and depth [mm] (H, W) uint16 or None.\n\nIt keeps the arrays and does "
          "not copy them: write to them no more. `number` counts the frames of the device: a camera whose\nnumber "
          "stands still stalls. Without a `time`, `Camera.read` gives it that of the first read of its number.")
      .def_prop_ro(
          "rgb",
          [](nb::handle_t<Frame> self) {
            const auto& f = nb::cast<const Frame&>(self);
            return View<const std::uint8_t>(f.rgb.get(), {std::size_t(f.height), std::size_t(f.width), 3}, self);
          },
          kOwned, "Colours, (H, W, 3) uint8, rows from the top, read-only.")
      .def_prop_ro(
          "depth_mm",
          [](nb::handle_t<Frame> self) -> std::optional<View<const std::uint16_t>> {
            const auto& f = nb::cast<const Frame&>(self);
            if (!f.depth_mm) return {};
            return View<const std::uint16_t>(f.depth_mm.get(), {std::size_t(f.height), std::size_t(f.width)}, self);
          },
          kOwned, "Depth [mm], (H, W) uint16, 0 = no reading, read-only; None without depth.")
      .def_ro("number", &Frame::number, "Counts frames of the device.");
  def_times(frame);

  nb::class_<Camera, rcs::Device, PyCamera>(
      m, "Camera",
      "One camera. Subclasses override `_read` and, where needed, `_calibration`, `_open`, `_recover`, `_close`.")
      .def(nb::init<std::string, CameraMode>(), "name"_a, "mode"_a)
      .def_prop_ro("mode", &Camera::mode)
      .def(
          "_calibration", [](Camera&) -> std::optional<CameraCalibration> { return {}; },
          "Matrix and distortion, as far as they are known; None unless overridden.")
      .def_prop_ro("calibration", &Camera::calibration, WithoutGil(),
                   "Matrix and distortion; None when they are unknown, which may be so until the camera is open.")
      .def("read", &Camera::read, WithoutGil(),
           "The newest frame. Raises DeviceFault when its size is not that of the mode, and when its time is ahead of "
           "the\nhost's monotonic clock by more than 0.1 s.");
}
