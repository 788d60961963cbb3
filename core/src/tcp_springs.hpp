// Torques of springs and dampers at the TCP of an arm: the paper's operational space control.
#pragma once

#include <mujoco/mujoco.h>

#include <array>
#include <span>
#include <vector>

#include "rcs/motion.hpp"
#include "serial_chain.hpp"

namespace rcs {

class TcpSprings {
 public:
  static bool are_valid(const Springs& springs);
  /// Throws `InvalidSetup` unless the base carries the TCP.
  TcpSprings(const mjModel* model, const std::vector<int>& joints, const Springs& springs);

  /// Add the torques that pull joints from `place` to `led`, positions [rad] and velocities [rad/s] one after the
  /// other. Motions that the springs leave free keep to `led` by a soft spring at the joints.
  void add(std::span<const double> place, std::span<const double> led, std::span<double> torques);

 private:
  using Six = std::array<double, 6>;

  Six stiffness_, damping_;
  SerialChain chain_;
  ChainPlace here_, there_;
  std::vector<Six> columns_;  // of the Jacobian
  std::vector<double> posture_;
};

}  // namespace rcs
