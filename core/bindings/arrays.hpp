// Numpy arrays in and out, as the bindings share them.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <cstddef>
#include <cstdint>
#include <span>
#include <string_view>
#include <utility>
#include <vector>

namespace nb = nanobind;

/// An array from Python. Dates and durations of NumPy are no numbers: they are refused here, as NumPy gives buffers
/// without strides for them, which nanobind reads.
template <typename... Form>
class In : public nb::ndarray<Form...> {
 public:
  using Base = nb::ndarray<Form...>;
  In() = default;
  In(Base array) : Base(std::move(array)) {}
};

template <typename... Form>
struct nanobind::detail::type_caster<In<Form...>> {
  using Inner = make_caster<typename In<Form...>::Base>;
  NB_TYPE_CASTER(In<Form...>, Inner::Name)

  bool from_python(handle source, std::uint32_t flags, cleanup_list* cleanup) noexcept {
    const std::string_view type = Py_TYPE(source.ptr())->tp_name;
    if (type == "numpy.datetime64" || type == "numpy.timedelta64") return false;
    Inner inner;
    if (!inner.from_python(source, flags, cleanup)) return false;
    value = In<Form...>(std::move(inner.value));
    return true;
  }
};

/// A float64 vector from Python, converted when it is a list or of another number type.
using Vector = In<const double, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
/// A float64 numpy array to Python.
using Array = nb::ndarray<nb::numpy, double>;
/// A numpy array to Python over memory of C++.
template <typename T>
using View = nb::ndarray<nb::numpy, T>;
/// One flag per geom, or per geom and flex, from Python.
using Flags = In<const std::uint8_t, nb::ndim<1>, nb::c_contig, nb::device::cpu>;

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
