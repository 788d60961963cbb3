// Pose, one at a time; what arrays of them have is in bind_pose_arrays.cpp.
#include <nanobind/nanobind.h>
#include <nanobind/operators.h>
#include <nanobind/stl/string.h>

#include <functional>

#include "pose_arrays.hpp"
#include "rcs/pose.hpp"

using namespace nb::literals;
using rcs::Pose;

void bind_pose(nb::module_& m) {
  nb::class_<Pose>(m, "Pose", R"(A translation [m] and a rotation: the pose of one frame in another, or a rigid motion.

Immutable and hashable. The quaternion is xyzw, of norm 1, and w is not negative, so equal rotations compare equal.
Bad numbers raise ValueError: not finite, a quaternion more than 1e-3 off norm 1, a matrix more than 1e-6
off a rotation.)")
      .def(
          "__init__",
          [](Pose* self, const ArrayLike& translation, const ArrayLike& quaternion) {
            new (self) Pose(read<3>(translation, "translation"), read<4>(quaternion, "quaternion"));
          },
          "translation"_a = nb::make_tuple(0.0, 0.0, 0.0), "quaternion"_a = nb::make_tuple(0.0, 0.0, 0.0, 1.0),
          "From a translation [m], shape (3,), and a quaternion xyzw, shape (4,).")
      .def_static(
          "from_matrix", [](const ArrayLike& matrix) { return Pose::from_matrix(read<4, 4>(matrix, "matrix")); },
          "matrix"_a, "From a homogeneous matrix, shape (4, 4).")
      .def_static(
          "from_rpy",
          [](const ArrayLike& translation, const ArrayLike& rpy) {
            return Pose::from_rpy(read<3>(translation, "translation"), read<3>(rpy, "rpy"));
          },
          "translation"_a, "rpy"_a,
          "From a translation [m] and roll, pitch, yaw [rad] about the fixed x, y, z axes, in that order.")
      .def_static(
          "from_rotvec",
          [](const ArrayLike& translation, const ArrayLike& rotvec) {
            return Pose::from_rotvec(read<3>(translation, "translation"), read<3>(rotvec, "rotvec"));
          },
          "translation"_a, "rotvec"_a, "From a translation [m] and a rotation vector: the axis times the angle [rad].")
      .def_static(
          "from_tquat", [](const ArrayLike& tquat) { return Pose::from_tquat(read<7>(tquat, "tquat")); }, "tquat"_a,
          "From translation [m] and quaternion xyzw in one array, shape (7,).")
      .def_static(
          "from_xyzrpy", [](const ArrayLike& xyzrpy) { return Pose::from_xyzrpy(read<6>(xyzrpy, "xyzrpy")); },
          "xyzrpy"_a, "From translation [m] and roll, pitch, yaw [rad] in one array, shape (6,).")
      .def_static(
          "exp", [](const ArrayLike& twist) { return Pose::exp(read<6>(twist, "twist")); }, "twist"_a,
          "The motion after one second at a constant twist [v m/s, w rad/s], shape (6,); the inverse of log.")
      .def_prop_ro(
          "translation", [](const Pose& self) { return array_of(self.translation()); }, "Translation [m], shape (3,).")
      .def_prop_ro(
          "quaternion", [](const Pose& self) { return array_of(self.quaternion()); },
          "Unit quaternion xyzw with w >= 0, shape (4,).")
      .def_prop_ro(
          "rpy", [](const Pose& self) { return array_of(self.rpy()); },
          "Roll, pitch, yaw [rad] about the fixed x, y, z axes, shape (3,); roll is 0 where pitch is +-pi/2.")
      .def_prop_ro(
          "rotvec", [](const Pose& self) { return array_of(self.rotvec()); },
          "Rotation vector: axis times angle [rad], the angle in [0, pi], shape (3,).")
      .def_prop_ro(
          "matrix",
          [](const Pose& self) { return fill_rows({}, {4, 4}, [&self](Py_ssize_t) { return self.matrix(); }); },
          "Homogeneous matrix, shape (4, 4).")
      .def_prop_ro(
          "tquat", [](const Pose& self) { return array_of(self.tquat()); },
          "Translation [m] and quaternion xyzw in one array, shape (7,).")
      .def_prop_ro(
          "xyzrpy", [](const Pose& self) { return array_of(self.xyzrpy()); },
          "Translation [m] and roll, pitch, yaw [rad] in one array, shape (6,).")
      .def(
          "log", [](const Pose& self) { return array_of(self.log()); },
          "The twist [v m/s, w rad/s] that reaches this pose from the identity in one second, shape (6,).")
      .def("inverse", &Pose::inverse, "The pose of A in B from that of B in A.")
      .def(
          "apply",
          [](const Pose& self, const ArrayLike& points) {
            return map<3>(points, "points", {3}, {3}, [&self](const auto& point) { return self.apply(point); });
          },
          "points"_a, "Points given in this frame [m], shape (..., 3), in the frame that this pose is in.")
      .def("interpolate", &Pose::interpolate, "to"_a, "fraction"_a,
           "The pose a fraction in [0, 1] of the way: straight line and shortest rotation, both at constant speed.")
      .def("angle_to", &Pose::angle_to, "other"_a, "Angle of the rotation to another pose [rad], in [0, pi].")
      .def("distance_to", &Pose::distance_to, "other"_a, "Distance of the origin to that of another pose [m].")
      .def("is_close", &Pose::is_close, "other"_a, "metres"_a, "radians"_a,
           "Whether another pose is within a distance and an angle.")
      .def(nb::self * nb::self, "The pose of C in A from those of B in A and C in B.")
      .def(nb::self == nb::self, nb::sig("def __eq__(self, other: object, /) -> bool"),
           "Whether every bit is the same.")
      .def("__hash__", std::hash<Pose>{})
      .def("__repr__", &rcs::to_string)
      .def("__reduce__", [](nb::handle_t<Pose> self) {
        const auto& [x, y, z] = nb::cast<const Pose&>(self).translation();
        const auto& [qx, qy, qz, qw] = nb::cast<const Pose&>(self).quaternion();
        return nb::make_tuple(self.type(), nb::make_tuple(nb::make_tuple(x, y, z), nb::make_tuple(qx, qy, qz, qw)));
      });
}
