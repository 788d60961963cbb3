// Arrays of numbers, row by row, in and out of the functions of poses.
#pragma once

#include <nanobind/nanobind.h>

#include <algorithm>
#include <array>
#include <initializer_list>
#include <span>
#include <stdexcept>
#include <string>
#include <string_view>

#include "rcs/pose.hpp"

namespace nb = nanobind;

inline bool is_anything(PyObject*) { return true; }

/// Types of arguments and results in the typed stubs.
struct ArrayLike : nb::object {
  NB_OBJECT_DEFAULT(ArrayLike, nb::object, "numpy.typing.ArrayLike", is_anything)
};
struct FloatArray : nb::object {
  NB_OBJECT_DEFAULT(FloatArray, nb::object, "numpy.typing.NDArray[numpy.float64]", is_anything)
};

using Shape = std::span<const Py_ssize_t>;

/// "(7,)" or "(4, 4)"; with a prefix of "..., " the shape of a batch: "(..., 7)".
inline std::string format(Shape shape, std::string_view prefix = "") {
  std::string sizes;
  for (const Py_ssize_t size : shape) sizes += (sizes.empty() ? "" : ", ") + std::to_string(size);
  return "(" + std::string(prefix) + sizes + (shape.size() == 1 && prefix.empty() ? ",)" : ")");
}

/// Looked up once and never freed: the lookup would take longer than the work on a single pose.
struct NumPy {
  PyObject* asarray = take("asarray");
  PyObject* empty = take("empty");
  PyObject* float64 = take("float64");

  static PyObject* take(const char* name) {
    return nb::object(nb::module_::import_("numpy").attr(name)).release().ptr();
  }
};

inline const NumPy& numpy() {
  static const NumPy names;
  return names;
}

/// An argument as C-contiguous float64 numbers. The buffer protocol takes 50 ns where nb::ndarray takes 150 ns, and an
/// environment's step makes many of these; what is not such a buffer (a list, float32, a slice) goes through NumPy.
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

/// An argument as rows of one shape, whatever the leading dimensions: a single pose is one row.
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
  rcs::Pose pose(Py_ssize_t row) const { return rcs::Pose::from_tquat(std::span<const double, 7>(at(row), 7)); }

 private:
  Numbers numbers_;
  std::size_t row_ndim_;
  Py_ssize_t row_size_ = 1;
  Py_ssize_t count_ = 1;
};

/// A fresh array of which every row holds what function(row number) returns.
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

/// An argument of exactly one shape, such as the translation of one pose.
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

/// Numbers in, numbers out, row by row.
template <std::size_t N, typename Function>
FloatArray map(const ArrayLike& source, const char* name, std::initializer_list<Py_ssize_t> row_shape,
               std::initializer_list<Py_ssize_t> result_shape, const Function& function) {
  const Rows rows(source, name, row_shape);
  return fill_rows(rows.leading(), result_shape, [&](Py_ssize_t row) { return function(rows.array<N>(row)); });
}
