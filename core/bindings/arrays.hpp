// Numpy arrays in and out, as the bindings share them.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

namespace nb = nanobind;

/// A float64 vector from Python, converted when it is a list or of another number type.
using Vector = nb::ndarray<const double, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
/// A float64 numpy array to Python.
using Array = nb::ndarray<nb::numpy, double>;
/// A numpy array to Python over memory of C++.
template <typename T>
using View = nb::ndarray<nb::numpy, T>;
/// One flag per geom, or per geom and flex, from Python.
using Flags = nb::ndarray<const std::uint8_t, nb::ndim<1>, nb::c_contig, nb::device::cpu>;

/// For properties that return views with an owner: nanobind would tie them to the object.
inline constexpr auto kOwned = nb::rv_policy::automatic;

inline std::vector<std::uint8_t> to_flags(const Flags& flags) { return {flags.data(), flags.data() + flags.shape(0)}; }
inline std::span<const double> to_span(const Vector& v) { return {v.data(), v.shape(0)}; }

/// A copy, for calls without the GIL: another thread may write to the array once it was checked.
inline std::vector<double> to_vector(const Vector& v) { return {v.data(), v.data() + v.shape(0)}; }

/// A numpy array that owns a copy of `values`.
inline Array to_array(std::span<const double> values, std::vector<std::size_t> shape = {}) {
  if (shape.empty()) shape = {values.size()};
  auto* copy = new std::vector<double>(values.begin(), values.end());
  const nb::capsule owner(copy, [](void* p) noexcept { delete static_cast<std::vector<double>*>(p); });
  return Array(copy->data(), shape.size(), shape.data(), owner);
}
