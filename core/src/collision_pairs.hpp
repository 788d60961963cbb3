// Which geoms of a model are checked against each other. Private to the sources.
#pragma once

#include <mujoco/mujoco.h>

#include <array>
#include <set>
#include <vector>

#include "moving_parts.hpp"

namespace rcs {

/// Two geoms, the smaller id first.
using GeomPair = std::array<int, 2>;

/// The pairs that joints move relative to each other, that MuJoCo lets touch and that are not in `allowed`, in order.
std::vector<GeomPair> pairs_to_check(const mjModel* model, const MovingParts& parts, const std::set<GeomPair>& allowed);

}  // namespace rcs
