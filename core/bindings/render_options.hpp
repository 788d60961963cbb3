// How Python says what a renderer is made for.
#pragma once

#include <mujoco/mujoco.h>

#include <array>
#include <stdexcept>
#include <string>

#include "rcs/renderer.hpp"

using Groups = std::array<bool, mjNGROUP>;

inline constexpr Groups kShown = {true, true, true, false, false, false};

inline rcs::RenderOptions render_options(const std::string& quality, int max_width, int max_height,
                                         const std::string& backend, const Groups& geom_groups,
                                         bool is_rasterised = false) {
  if (quality != "fast" && quality != "full")
    throw std::invalid_argument("there is no quality \"" + quality + "\"; known: fast, full");
  const rcs::Quality level = quality == "fast" ? rcs::Quality::fast : rcs::Quality::full;
  return {level, max_width, max_height, backend, geom_groups, is_rasterised};
}
