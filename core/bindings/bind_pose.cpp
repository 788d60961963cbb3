// Pose, and the functions on arrays of poses that rcs.spatial.arrays gives names and types.
#include <nanobind/nanobind.h>
#include <nanobind/operators.h>
#include <nanobind/stl/string.h>

#include <algorithm>
#include <array>
#include <functional>
#include <initializer_list>
#include <span>
#include <stdexcept>
#include <string>
#include <string_view>

#include "rcs/pose.hpp"

namespace nb = nanobind;
using namespace nb::literals;
using rcs::Pose;

namespace {

bool is_anything(PyObject*) { return true; }

// What arguments and results are called in the typed stubs.
struct ArrayLike : nb::object {
  NB_OBJECT_DEFAULT(ArrayLike, nb::object, "numpy.typing.ArrayLike", is_anything)
};
struct FloatArray : nb::object {
  NB_OBJECT_DEFAULT(FloatArray, nb::object, "numpy.typing.NDArray[numpy.float64]", is_anything)
};

using Shape = std::span<const Py_ssize_t>;

// "(7,)" or "(4, 4)"; with a prefix of "..., " the shape of a batch: "(..., 7)".
std::string format(Shape shape, std::string_view prefix = "") {
  std::string sizes;
  for (const Py_ssize_t size : shape) sizes += (sizes.empty() ? "" : ", ") + std::to_string(size);
  return "(" + std::string(prefix) + sizes + (shape.size() == 1 && prefix.empty() ? ",)" : ")");
}

// Looked up once and never freed: the lookup would take longer than the work on a single pose.
struct NumPy {
  PyObject* asarray = take("asarray");
  PyObject* empty = take("empty");
  PyObject* float64 = take("float64");

  static PyObject* take(const char* name) {
    return nb::object(nb::module_::import_("numpy").attr(name)).release().ptr();
  }
};

const NumPy& numpy() {
  static const NumPy names;
  return names;
}

// An argument as C-contiguous float64 numbers. The buffer protocol takes 50 ns where nb::ndarray takes 150 ns, and an
// environment's step makes many of these; what is not such a buffer (a list, float32, a slice) goes through NumPy.
class Numbers {
 public:
  explicit Numbers(const nb::object& source) {
    if (view(source)) return;
    if (!view(nb::handle(numpy().asarray)(source, nb::handle(numpy().float64), "C")))
      throw std::invalid_argument("expected float64 numbers");
  }
  ~Numbers() { PyBuffer_Release(&buffer_); }
  Numbers(const Numbers&) = delete;
  Numbers& operator=(const Numbers&) = delete;

  Shape shape() const { return {buffer_.shape, static_cast<std::size_t>(buffer_.ndim)}; }
  const double* data() const { return static_cast<const double*>(buffer_.buf); }

 private:
  bool view(const nb::object& source) {
    if (!PyObject_CheckBuffer(source.ptr()) || PyObject_GetBuffer(source.ptr(), &buffer_, PyBUF_RECORDS_RO) != 0) {
      PyErr_Clear();
      return false;
    }
    if (std::string_view(buffer_.format) == "d" && PyBuffer_IsContiguous(&buffer_, 'C')) return true;
    PyBuffer_Release(&buffer_);
    return false;
  }

  Py_buffer buffer_{};
};

// An argument as rows of one shape, whatever the leading dimensions: a single pose is one row.
class Rows {
 public:
  Rows(const nb::object& source, const char* name, std::initializer_list<Py_ssize_t> row_shape)
      : numbers_(source), row_ndim_(row_shape.size()) {
    const Shape shape = numbers_.shape();
    if (shape.size() < row_ndim_ || !std::equal(row_shape.begin(), row_shape.end(), shape.end() - row_ndim_)) {
      const std::string valid = format({row_shape.begin(), row_ndim_}, row_ndim_ > 0 ? "..., " : "...");
      throw std::invalid_argument(std::string(name) + " must have the shape " + valid + ", got " + format(shape));
    }
    for (const Py_ssize_t size : row_shape) row_size_ *= size;
    for (const Py_ssize_t size : leading()) count_ *= size;
  }

  Shape leading() const { return numbers_.shape().first(numbers_.shape().size() - row_ndim_); }
  Py_ssize_t count() const { return count_; }
  // A lone row stands for every row of a batch.
  const double* at(Py_ssize_t row) const { return numbers_.data() + (count_ == 1 ? 0 : row * row_size_); }
  template <std::size_t N>
  std::array<double, N> array(Py_ssize_t row) const {
    std::array<double, N> values;
    std::copy_n(at(row), N, values.begin());
    return values;
  }
  Pose pose(Py_ssize_t row) const { return Pose::from_tquat(std::span<const double, 7>(at(row), 7)); }

 private:
  Numbers numbers_;
  std::size_t row_ndim_;
  Py_ssize_t row_size_ = 1;
  Py_ssize_t count_ = 1;
};

// A fresh array of which every row holds what function(row number) returns.
template <typename Function>
FloatArray fill_rows(Shape leading, std::initializer_list<Py_ssize_t> row_shape, const Function& function) {
  nb::object shape = nb::steal(PyTuple_New(static_cast<Py_ssize_t>(leading.size() + row_shape.size())));
  Py_ssize_t count = 1, row_size = 1, dimension = 0;
  for (const Py_ssize_t size : leading) {
    PyTuple_SET_ITEM(shape.ptr(), dimension++, PyLong_FromSsize_t(size));
    count *= size;
  }
  for (const Py_ssize_t size : row_shape) {
    PyTuple_SET_ITEM(shape.ptr(), dimension++, PyLong_FromSsize_t(size));
    row_size *= size;
  }
  FloatArray result(nb::handle(numpy().empty)(shape).release(), nb::detail::steal_t{});
  const Numbers numbers(result);
  double* const out = const_cast<double*>(numbers.data());
  for (Py_ssize_t row = 0; row < count; ++row) {
    try {
      const auto values = function(row);
      std::copy(values.begin(), values.end(), out + row * row_size);
    } catch (const std::invalid_argument& error) {
      if (leading.empty()) throw;
      throw std::invalid_argument("row " + std::to_string(row) + ": " + error.what());
    }
  }
  return result;
}

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

// An argument of exactly one shape, such as the translation of one pose.
template <Py_ssize_t... Sizes>
std::array<double, static_cast<std::size_t>((Sizes * ...))> read(const ArrayLike& source, const char* name) {
  constexpr std::array<Py_ssize_t, sizeof...(Sizes)> valid{Sizes...};
  const Numbers numbers(source);
  if (!std::ranges::equal(numbers.shape(), valid))
    throw std::invalid_argument(std::string(name) + " must have the shape " + format(valid) + ", got " +
                                format(numbers.shape()));
  std::array<double, static_cast<std::size_t>((Sizes * ...))> values;
  std::copy_n(numbers.data(), values.size(), values.begin());
  return values;
}

template <std::size_t N>
FloatArray array_of(const std::array<double, N>& values) {
  return fill_rows({}, {static_cast<Py_ssize_t>(N)}, [&values](Py_ssize_t) { return values; });
}

// Numbers in, numbers out, row by row.
template <std::size_t N, typename Function>
FloatArray map(const ArrayLike& source, const char* name, std::initializer_list<Py_ssize_t> row_shape,
               std::initializer_list<Py_ssize_t> result_shape, const Function& function) {
  const Rows rows(source, name, row_shape);
  return fill_rows(rows.leading(), result_shape, [&](Py_ssize_t row) { return function(rows.array<N>(row)); });
}

// Two poses in, numbers out, row by row.
template <typename Function>
FloatArray map_pairs(const ArrayLike& a, const ArrayLike& b, std::array<const char*, 2> names, Py_ssize_t result_size,
                     const Function& function) {
  const Rows first(a, names[0], {7}), second(b, names[1], {7});
  return fill_rows(common_leading({&first, &second}), {result_size},
                   [&](Py_ssize_t row) { return function(first.pose(row), second.pose(row)); });
}

void bind_class(nb::module_& m) {
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

}  // namespace

void bind_pose(nb::module_& m) {
  bind_class(m);
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
