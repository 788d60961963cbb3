// Checks and limits on rows of numbers.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/pair.h>

#include <memory>
#include <optional>
#include <utility>
#include <vector>

#include "arrays.hpp"
#include "rcs/rows.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace {

template <typename T>
using Rows = In<const T, nb::c_contig, nb::device::cpu>;
template <typename T>
using Numpy = nb::ndarray<nb::numpy, T>;

template <typename T>
Numpy<T> like(T* data, const nb::ndarray<const T, nb::c_contig, nb::device::cpu>& shape_of) {
  std::vector<std::size_t> shape(shape_of.ndim());
  for (std::size_t i = 0; i < shape.size(); ++i) shape[i] = shape_of.shape(i);
  const nb::capsule owner(data, [](void* p) noexcept { delete[] static_cast<T*>(p); });
  return Numpy<T>(data, shape.size(), shape.data(), owner);
}

template <typename T>
std::optional<Numpy<T>> clip(const Rows<T>& values, const Rows<T>& lower, const Rows<T>& upper, double tolerance) {
  const std::size_t width = lower.size();
  if (width == 0 || upper.size() != width || values.size() % width)
    throw nb::value_error("clip_rows: rows must have the length of the bounds");
  std::unique_ptr<T[]> clipped(new T[values.size()]);
  if (!rcs::clip_rows<T>({values.data(), values.size()}, {lower.data(), width}, {upper.data(), width}, tolerance,
                         {clipped.get(), values.size()}))
    return std::nullopt;
  return like<T>(clipped.release(), values);
}

std::optional<std::pair<Numpy<double>, Numpy<bool>>> limit(const Rows<double>& asked, const Rows<double>& last,
                                                           const Rows<double>& measured, const Rows<double>& max_step,
                                                           const Rows<double>& max_lead, const Rows<double>& lower,
                                                           const Rows<double>& upper, double max_return,
                                                           double rounding) {
  const std::size_t width = max_step.size(), size = asked.size();
  if (width == 0 || max_lead.size() != width || lower.size() != width || upper.size() != width || last.size() != size ||
      measured.size() != size || size % width)
    throw nb::value_error("limit_rows: asked, last and measured must be rows of the length of the limits");
  std::unique_ptr<double[]> target(new double[size]);
  std::unique_ptr<bool[]> is_cut(new bool[size / width]);
  if (!rcs::limit_rows({asked.data(), size}, {last.data(), size}, {measured.data(), size},
                       {{max_step.data(), width},
                        {max_lead.data(), width},
                        {lower.data(), width},
                        {upper.data(), width},
                        max_return},
                       rounding, {target.get(), size}, {is_cut.get(), size / width}))
    return std::nullopt;
  std::vector<std::size_t> shape;
  for (std::size_t i = 0; i + 1 < asked.ndim(); ++i) shape.push_back(asked.shape(i));
  bool* flags = is_cut.release();
  const nb::capsule owner(flags, [](void* p) noexcept { delete[] static_cast<bool*>(p); });
  return std::pair(like<double>(target.release(), asked), Numpy<bool>(flags, shape.size(), shape.data(), owner));
}

}  // namespace

void bind_rows(nb::module_& m) {
  m.def("clip_rows", &clip<double>, "values"_a.noconvert(), "lower"_a.noconvert(), "upper"_a.noconvert(), "tolerance"_a,
        "Return a copy of `values` (..., n) cut to the bounds (n,); None if one is not finite or farther out than "
        "`tolerance`.");
  m.def("clip_rows", &clip<float>, "values"_a.noconvert(), "lower"_a.noconvert(), "upper"_a.noconvert(), "tolerance"_a,
        "The same in float32.");
  m.def("limit_rows", &limit, "asked"_a, "last"_a, "measured"_a, "max_step"_a, "max_lead"_a, "lower"_a, "upper"_a,
        "max_return"_a, "rounding"_a,
        "Cut `asked` (..., n) to at most `max_step` (n,) from `last` and `max_lead` (n,) from `measured`: all joints "
        "of a row "
        "go the same share of the way from `last`.\n\nA joint that was pushed out of its lead goes back towards it "
        "first, by a step at most; one that is asked for less of its lead, or for the other side of the measured "
        "joint, drops it at once. One whose last target is out of its range, `lower` to `upper` (n,), comes back by "
        "`max_return` at most. Returns the targets and a flag per row that says whether it was cut by more than "
        "`rounding`; None if no row was.");
}
