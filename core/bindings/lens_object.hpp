// The lens of a camera as Python has it.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <optional>

#include "arrays.hpp"
#include "rcs/lens.hpp"

using Lookup = In<const float, nanobind::numpy, nanobind::c_contig, nanobind::device::cpu, nanobind::shape<-1, -1, 2>>;

/// A lens with the memory that it points to.
struct PyLens {
  rcs::Lens value;
  std::optional<Lookup> lookup;
};
