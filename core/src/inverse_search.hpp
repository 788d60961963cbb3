// The search for joints that lead a TCP to a target, by steps of damped least squares. Private to the sources.
#pragma once

#include <array>
#include <span>
#include <vector>

#include "rcs/kinematics.hpp"
#include "task_matrix.hpp"

namespace rcs {

/// An arm at some joints, and what a solve computes in.
struct Workspace {
  explicit Workspace(std::size_t dof)
      : jacobian(dof), step(dof), candidate(dof), is_free(dof), lower(dof), upper(dof) {}
  virtual ~Workspace() = default;
  Workspace(const Workspace&) = delete;
  Workspace& operator=(const Workspace&) = delete;

  /// Lead the joints to positions [rad, m], and the TCP with them.
  virtual void put(std::span<const double> joints) = 0;
  /// Write the Jacobian of the joints that `put` had last.
  virtual void differentiate() = 0;

  std::array<double, 3> translation{};              ///< of the TCP in the base frame [m]
  std::array<double, 4> quaternion{1, 0, 0, 0};     ///< likewise, wxyz
  std::vector<std::array<double, kTask>> jacobian;  ///< a column per joint: translation, then rotation
  std::array<double, kTask> error{};                ///< from the joints of the Jacobian to the target
  std::vector<double> step;                         ///< rad
  std::vector<double> candidate;                    ///< rad
  std::vector<char> is_free;                        ///< joints that are not fixed at a limit
  std::vector<double> lower, upper;                 ///< rad, the range of this solve
};

/// Look for joints of a target from a start, within limits.
IkResult solve_inverse(Workspace& scratch, const std::vector<double>& lower, const std::vector<double>& upper,
                       const Pose& target, std::span<const double> start, const IkOptions& options);

}  // namespace rcs
