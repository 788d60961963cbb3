// The functions on arrays of poses that rcs.spatial.arrays gives names and types.
#include <nanobind/nanobind.h>

#include <algorithm>
#include <array>
#include <initializer_list>
#include <stdexcept>

#include "pose_arrays.hpp"
#include "rcs/pose.hpp"

using namespace nb::literals;
using rcs::Pose;

namespace {

// The leading dimensions of the result: all inputs agree, or hold a single row that serves every row of the others.
Shape common_leading(std::initializer_list<const Rows*> inputs) {
  const auto is_smaller = [](const Rows* a, const Rows* b) {
    if (a->leading().size() != b->leading().size()) return a->leading().size() < b->leading().size();
    return a->count() == 1 && b->count() != 1;
  };
  const Shape widest = (*std::max_element(inputs.begin(), inputs.end(), is_smaller))->leading();
  for (const Rows* input : inputs)
    if (input->count() != 1 && !std::ranges::equal(input->leading(), widest))
      throw std::invalid_argument("arguments must have equal leading shapes or hold a single pose, got " +
                                  format(input->leading()) + " and " + format(widest));
  return widest;
}

// Two poses in, numbers out, row by row.
template <typename Function>
FloatArray map_pairs(const ArrayLike& a, const ArrayLike& b, std::array<const char*, 2> names, Py_ssize_t result_size,
                     const Function& function) {
  const Rows first(a, names[0], {7}), second(b, names[1], {7});
  return fill_rows(common_leading({&first, &second}), {result_size},
                   [&](Py_ssize_t row) { return function(first.pose(row), second.pose(row)); });
}

}  // namespace

void bind_pose_arrays(nb::module_& m) {
  m.def(
      "compose_tquat",
      [](const ArrayLike& a, const ArrayLike& b) {
        return map_pairs(a, b, {"a", "b"}, 7, [](const Pose& x, const Pose& y) { return (x * y).tquat(); });
      },
      "a"_a, "b"_a, R"(Chain poses: those of C in A from those of B in A and C in B.

Args:
    a: Poses of B in A as tquat, shape (..., 7).
    b: Poses of C in B as tquat, shape (..., 7).)");
  m.def(
      "inverse_tquat",
      [](const ArrayLike& a) {
        return map<7>(a, "a", {7}, {7}, [](const auto& row) { return Pose::from_tquat(row).inverse().tquat(); });
      },
      "a"_a, R"(Invert poses: those of A in B from those of B in A.

Args:
    a: Poses of B in A as tquat, shape (..., 7).)");
  m.def(
      "relative_tquat",
      [](const ArrayLike& a, const ArrayLike& b) {
        return map_pairs(a, b, {"a", "b"}, 7, [](const Pose& x, const Pose& y) { return (x.inverse() * y).tquat(); });
      },
      "a"_a, "b"_a, R"(Express poses in the frames of others: inverse(a) composed with b.

Args:
    a: Poses of the new frames of reference as tquat, shape (..., 7).
    b: Poses given in the same frame as `a`, as tquat, shape (..., 7).)");
  m.def(
      "interpolate_tquat",
      [](const ArrayLike& a, const ArrayLike& b, const ArrayLike& fraction) {
        const Rows from(a, "a", {7}), to(b, "b", {7}), part(fraction, "fraction", {});
        return fill_rows(common_leading({&from, &to, &part}), {7}, [&](Py_ssize_t row) {
          return from.pose(row).interpolate(to.pose(row), *part.at(row)).tquat();
        });
      },
      "a"_a, "b"_a, "fraction"_a,
      R"(Interpolate between poses: straight line and shortest rotation, both at constant speed.

Args:
    a: Poses at fraction 0 as tquat, shape (..., 7).
    b: Poses at fraction 1 as tquat, shape (..., 7).
    fraction: Fractions in [0, 1], shape (...). Several fractions between two single poses make a path.

Raises:
    ValueError: A fraction is outside [0, 1].)");
  m.def(
      "limit_step_tquat",
      [](const ArrayLike& start, const ArrayLike& goal, double max_translation, double max_rotation) {
        return map_pairs(start, goal, {"start", "goal"}, 7, [&](const Pose& from, const Pose& to) {
          return rcs::limit_step(from, to, max_translation, max_rotation).tquat();
        });
      },
      "start"_a, "goal"_a, "max_translation"_a, "max_rotation"_a,
      R"(Move from start towards goal within limits on translation and on rotation.

Args:
    start: Poses to start from as tquat, shape (..., 7).
    goal: Poses to reach as tquat, shape (..., 7); returned unchanged if within both limits.
    max_translation: Longest distance from start [m], at least 0; infinity for no limit.
    max_rotation: Largest angle from start [rad], at least 0; infinity for no limit.

Raises:
    ValueError: A limit is below 0 or NaN.)");
  m.def(
      "distance_tquat",
      [](const ArrayLike& a, const ArrayLike& b) {
        return map_pairs(a, b, {"a", "b"}, 2,
                         [](const Pose& x, const Pose& y) { return std::array{x.distance_to(y), x.angle_to(y)}; });
      },
      "a"_a, "b"_a,
      R"(Measure how far poses are apart: distance of the origins [m] and angle of the rotation [rad], shape (..., 2).

Args:
    a: Poses as tquat, shape (..., 7).
    b: Poses as tquat, shape (..., 7).)");
  m.def(
      "normalize_tquat",
      [](const ArrayLike& tquat) {
        return map<7>(tquat, "tquat", {7}, {7}, [](const std::array<double, 7>& row) {
          return Pose({row[0], row[1], row[2]}, rcs::normalize_quaternion({row[3], row[4], row[5], row[6]})).tquat();
        });
      },
      "tquat"_a, R"(Normalize quaternions of any length to norm 1 and w >= 0, for numbers from a policy or file.

Args:
    tquat: Translations [m] and quaternions xyzw of any length but 0, shape (..., 7).

Raises:
    ValueError: All components of a quaternion are below 1e-9, so it has no direction.)");
  m.def(
      "tquat_to_xyzrpy",
      [](const ArrayLike& tquat) {
        return map<7>(tquat, "tquat", {7}, {6}, [](const auto& row) { return Pose::from_tquat(row).xyzrpy(); });
      },
      "tquat"_a, R"(Convert quaternions to roll, pitch, yaw: roll and yaw in (-pi, pi], pitch in [-pi/2, pi/2].

Args:
    tquat: Poses, shape (..., 7). If pitch is ±pi/2, roll is chosen as 0.)");
  m.def(
      "xyzrpy_to_tquat",
      [](const ArrayLike& xyzrpy) {
        return map<6>(xyzrpy, "xyzrpy", {6}, {7}, [](const auto& row) { return Pose::from_xyzrpy(row).tquat(); });
      },
      "xyzrpy"_a, R"(Convert roll, pitch, yaw to quaternions.

Args:
    xyzrpy: Poses, shape (..., 6), with angles of any size.)");
  m.def(
      "tquat_to_matrix",
      [](const ArrayLike& tquat) {
        return map<7>(tquat, "tquat", {7}, {4, 4}, [](const auto& row) { return Pose::from_tquat(row).matrix(); });
      },
      "tquat"_a, R"(Convert poses to homogeneous matrices, shape (..., 4, 4).

Args:
    tquat: Poses, shape (..., 7).)");
  m.def(
      "matrix_to_tquat",
      [](const ArrayLike& matrix) {
        return map<16>(matrix, "matrix", {4, 4}, {7}, [](const auto& row) { return Pose::from_matrix(row).tquat(); });
      },
      "matrix"_a, R"(Convert homogeneous matrices to poses, shape (..., 7).

Args:
    matrix: Rotations and translations [m] above the row (0, 0, 0, 1), shape (..., 4, 4).

Raises:
    ValueError: A matrix is more than 1e-6 off a rotation.)");
  m.def(
      "wxyz_to_xyzw", [](const ArrayLike& wxyz) { return map<4>(wxyz, "wxyz", {4}, {4}, rcs::wxyz_to_xyzw); }, "wxyz"_a,
      R"(Reorder quaternions of MuJoCo; the numbers stay as they are.

Args:
    wxyz: Quaternions with the scalar first, shape (..., 4).)");
  m.def(
      "xyzw_to_wxyz", [](const ArrayLike& xyzw) { return map<4>(xyzw, "xyzw", {4}, {4}, rcs::xyzw_to_wxyz); }, "xyzw"_a,
      R"(Reorder quaternions for MuJoCo; the numbers stay as they are.

Args:
    xyzw: Quaternions with the scalar last, shape (..., 4).)");
}
