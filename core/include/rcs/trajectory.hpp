// How the joints of an arm move to targets that are given step by step: within limits, and stoppable at any time.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "rcs/interface.hpp"

namespace rcs {

/// Limits of a motion, one value per joint.
struct RCS_API MotionLimits {
  std::vector<double> lower;         ///< rad
  std::vector<double> upper;         ///< rad
  std::vector<double> velocity;      ///< rad/s
  std::vector<double> acceleration;  ///< rad/s²
  std::vector<double> jerk;          ///< rad/s³

  /// Throws `InvalidSetup` unless every vector has `dof` values, ranges ascend and limits are positive.
  void check(int dof) const;

  /// How far a target may lead each joint [rad], when targets come every `period` [s]: what an arm at full speed needs
  /// to stop, were it to brake at half of its acceleration, and what a target makes at full speed in two periods. A
  /// target that leads by less slows the arm down; one that leads by more has no effect.
  std::vector<double> lead(double period) const;
};

/// The law of motion of an arm: what its joints do between one target and the next.
///
/// A target that comes to rest is reached along a trajectory that takes the least time, on a straight line in joint
/// space where the arm starts at rest. A target that goes on from step to step is followed: it is reached when the step
/// ends, at the speed at which the target moves, so that a stream of small steps is a smooth motion. At higher speeds
/// the arm stays behind by the distance that it needs to stop, and while it gains speed it aims at no more than it can
/// reach without going back. So a target never makes a joint move away from it, and a stream that ends is passed by no
/// more than 0.03 rad.
///
/// All that is remembered is in the caller's memory of `size(dof)` numbers: memory that is saved and restored goes on
/// with the same bits. The object itself keeps the plan that belongs to the memory it saw last.
class RCS_API Trajectory {
 public:
  /// The time of a step.
  struct Step {
    double period;        ///< nominal control period [s]
    double duration;      ///< of this step [s], a multiple of the physics step
    double rest;          ///< from the end of this step to the nominal one [s]
    bool is_synchronous;  ///< the step lasts until the target is reached
  };

  /// Numbers that `dof` joints take. The first `dof` are the target, the last is the order to hold.
  static constexpr int size(int dof) { return 8 * dof + 5; }
  /// Rows of `dof` numbers that are positions; where the joints stand still, all are equal and every other number is 0.
  static std::vector<int> position_rows();
  /// Write that: the joints stop there at once, whatever their speed.
  static void stand(std::span<double> memory, std::span<const double> joints);

  /// Throws `InvalidSetup` for limits that are not valid.
  explicit Trajectory(MotionLimits limits);
  Trajectory(const Trajectory&) = delete;
  Trajectory& operator=(const Trajectory&) = delete;
  ~Trajectory();

  int dof() const { return static_cast<int>(limits_.lower.size()); }
  const MotionLimits& limits() const { return limits_; }

  /// True if the joints are to hold: the order is one number that is not 0, which any thread may write.
  bool is_told_to_hold(const double* memory) const { return memory[size(dof()) - 1] != 0.0; }
  /// True if the target that was written into the memory asks for a new plan.
  bool is_asked(const double* memory);
  /// Plan the motion of a step to the target, with this share of the acceleration (0 … 1).
  void follow(double* memory, const Step& step, double share);
  /// Begin anew from these positions and velocities.
  void put(double* memory, std::span<const double> joints, std::span<const double> velocities);
  /// Brake to rest with this share of the acceleration, all joints together on a straight line where they can; joints
  /// that brake already go on with it. The target becomes where they will come to rest, and the order to hold is
  /// carried out.
  void brake(double* memory, double share);
  /// Let time pass [s]. At the end of the plan, the joints stand.
  void advance(double* memory, double time);

  /// Evaluate the plan so many seconds after the present; the values are in `position`, `velocity`, `acceleration`.
  void look(const double* memory, double ahead);
  std::span<const double> position() const;
  std::span<const double> velocity() const;
  std::span<const double> acceleration() const;
  /// Time until the joints are to stand still [s]; of a stream, until the plan is used up.
  double remaining(const double* memory);
  /// True if nothing is planned but to stand.
  bool is_still(const double* memory);

 private:
  struct Plan;

  Plan& plan(const double* memory);
  double within(std::size_t joint, double target, double position) const;
  double stay_behind(double speed_share);
  double spare_way(std::size_t joint, double share, double behind, double horizon) const;
  void let_go(std::size_t joint, double behind, double horizon);
  double gained_share(std::size_t first, std::size_t count, double horizon);

  MotionLimits limits_;
  std::unique_ptr<Plan> plan_;
};

}  // namespace rcs
