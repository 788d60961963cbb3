// Counts of clamped commands, as a dict.
#pragma once

#include <nanobind/nanobind.h>

#include "rcs/streamed_arm.hpp"

inline nanobind::typed<nanobind::dict, nanobind::str, nanobind::int_> counts_of(const rcs::Clamped& all) {
  nanobind::typed<nanobind::dict, nanobind::str, nanobind::int_> counts;
  counts["range"] = all.range;
  counts["speed"] = all.speed;
  counts["acceleration"] = all.acceleration;
  counts["jerk"] = all.jerk;
  counts["box"] = all.box;
  return counts;
}
