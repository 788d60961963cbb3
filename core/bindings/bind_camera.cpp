// Camera: the interface that delivers frames.
#include <nanobind/nanobind.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/string.h>

#include <cstring>
#include <optional>

#include "arrays.hpp"
#include "overrides.hpp"
#include "rcs/camera.hpp"

using namespace nb::literals;

namespace {

using Rgb = In<const std::uint8_t, nb::shape<-1, -1, 3>, nb::c_contig, nb::device::cpu>;
using Depth = In<const std::uint16_t, nb::ndim<2>, nb::c_contig, nb::device::cpu>;

struct PyCamera : PyDevice<rcs::Camera> {
  using PyDevice::PyDevice;
  rcs::Frame do_read() override { return call<rcs::Frame>("_read", "a Frame"); }
};

rcs::Frame make_frame(const Rgb& rgb, const std::optional<Depth>& depth, double time, std::uint64_t number) {
  rcs::Frame frame;
  frame.rgb.assign(rgb.data(), rgb.data() + rgb.size());
  if (depth) frame.depth_mm.assign(depth->data(), depth->data() + depth->size());
  frame.time = time;
  frame.number = number;
  return frame;
}

template <typename T>
nb::ndarray<nb::numpy, T> copy_out(const std::vector<T>& values, std::initializer_list<std::size_t> shape) {
  auto* copy = new std::vector<T>(values);
  const nb::capsule owner(copy, [](void* p) noexcept { delete static_cast<std::vector<T>*>(p); });
  return nb::ndarray<nb::numpy, T>(copy->data(), shape, owner);
}

}  // namespace

void bind_camera(nb::module_& m) {
  nb::class_<rcs::CameraMode>(m, "CameraMode", "What a camera delivers, and at what size.")
      .def(nb::init<int, int, double, bool>(), "width"_a, "height"_a, "fps"_a, "has_depth"_a = false)
      .def_ro("width", &rcs::CameraMode::width, "Pixels.")
      .def_ro("height", &rcs::CameraMode::height, "Pixels.")
      .def_ro("fps", &rcs::CameraMode::fps, "Frames per second.")
      .def_ro("has_depth", &rcs::CameraMode::has_depth);
  nb::class_<rcs::Frame>(m, "Frame", "One picture. Arrays are flat copies; `Camera.read` knows the size.")
      .def(
          "__init__",
          [](rcs::Frame* self, const Rgb& rgb, const std::optional<Depth>& depth_mm, double time,
             std::uint64_t number) { new (self) rcs::Frame(make_frame(rgb, depth_mm, time, number)); },
          "rgb"_a, "depth_mm"_a = nb::none(), "time"_a = 0.0, "number"_a = 0,
          "Make a frame of rgb (H, W, 3) uint8, depth [mm] (H, W) uint16 or None, and its capture time [s].")
      .def_prop_ro(
          "rgb", [](const rcs::Frame& f) { return copy_out(f.rgb, {f.rgb.size() / 3, 3}); }, nb::rv_policy::move,
          "Colours, (H·W, 3) uint8, rows from the top.")
      .def_prop_ro(
          "depth_mm", [](const rcs::Frame& f) { return copy_out(f.depth_mm, {f.depth_mm.size()}); },
          nb::rv_policy::move, "Depth [mm], (H·W,) uint16, 0 = no reading; empty without depth.")
      .def_ro("time", &rcs::Frame::time, "When the picture was taken [s].")
      .def_ro("number", &rcs::Frame::number, "Counts frames of the device.");
  nb::class_<rcs::Camera, rcs::Device, PyCamera>(
      m, "Camera",
      "One camera. Subclasses override `_read` and, where needed, `_open`, `_recover`, "
      "`_close`.")
      .def(nb::init<std::string, rcs::CameraMode>(), "name"_a, "mode"_a)
      .def_prop_ro("mode", &rcs::Camera::mode)
      .def("read", &rcs::Camera::read, WithoutGil(),
           "The newest frame. Raises DeviceFault when its size is not that of the mode.");
}
