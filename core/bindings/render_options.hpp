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
                                         const std::string& backend, const Groups& geom_groups) {
  if (quality != "fast" && quality != "full")
    throw std::invalid_argument("there is no quality \"" + quality + "\"; known: fast, full");
  return {quality == "fast" ? rcs::Quality::fast : rcs::Quality::full, max_width, max_height, backend, geom_groups};
}
