// How joints move to their targets: along trajectories within limits of velocity, acceleration and jerk.
#pragma once

#include <mujoco/mujoco.h>

#include <memory>
#include <span>
#include <vector>

#include "rcs/callback.hpp"

namespace rcs {

/// Limits of a motion, one value per joint.
struct MotionLimits {
  std::vector<double> lower;         ///< rad
  std::vector<double> upper;         ///< rad
  std::vector<double> velocity;      ///< rad/s
  std::vector<double> acceleration;  ///< rad/s²
  std::vector<double> jerk;          ///< rad/s³

  /// Throws `InvalidSetup` unless every vector has `dof` values, ranges ascend and limits are positive.
  void check(int dof) const;
};

/// Moves position servos of some joints to a target, in each copy of a world.
///
/// A target that comes to rest is reached along a trajectory that takes the least time, on a straight line in joint
/// space where the arm starts at rest. A target that goes on from step to step is followed: it is reached when the step
/// ends, at the speed at which the target moves, so that a stream of small steps is a smooth motion. At higher speeds
/// the arm stays behind by the distance that it needs to stop, so that a stream that ends is overshot by no more than
/// 0.03 rad.
///
/// All that the motion remembers is in the copy's `mjData.userdata`: a state that is saved and restored goes on with
/// the same bits. Besides the position, the servo is given the velocity, so that it does not lag behind.
///
/// As a callback, it is true when the joints stand at their target.
class Motion final : public StepCallback {
 public:
  /// The time of a step.
  struct Step {
    double period;        ///< nominal control period [s]
    double duration;      ///< of this step [s], a multiple of the physics step
    double rest;          ///< from the end of this step to the nominal one [s]
    bool is_synchronous;  ///< the step lasts until the target is reached
  };

  /// Numbers of user data that `dof` joints take.
  static constexpr int size(int dof) { return 8 * dof + 2; }

  /// Rows of `dof` numbers that are positions; where the joints stand still, all are equal and every other number is 0.
  static std::vector<int> position_rows();
  /// Write that, of `size(joints.size())` numbers: the joints stop there at once, whatever their speed.
  static void stand(std::span<double> user, std::span<const double> joints);

  /// `joints` are hinge or slide joint ids, base to tip, `actuators` their position servos, `address` the first of the
  /// numbers in `mjData.userdata`. Throws `InvalidSetup` if they do not fit each other.
  Motion(std::vector<int> joints, std::vector<int> actuators, int address, MotionLimits limits, int copies);
  Motion(const Motion&) = delete;
  Motion& operator=(const Motion&) = delete;
  ~Motion() override;

  int dof() const { return static_cast<int>(joints_.size()); }
  int address() const { return address_; }
  const std::vector<int>& joints() const { return joints_; }

  /// Plan the motion of a step. The target is what was written into the first `dof` numbers.
  void begin(const mjModel* model, mjData* data, int copy, const Step& step);
  /// Write the controls of the next physics step.
  void advance(const mjModel* model, mjData* data, int copy);
  /// Where the joints are led to at present: positions, velocities and accelerations, `dof` numbers each.
  std::vector<double> state(const mjData* data, int copy);
  /// Time until the joints are to stand still [s].
  double remaining(const mjData* data, int copy);

  bool call(const StepView& view) override;
  void check(const mjModel* model, int copies) const override;

 private:
  struct Plan;

  Plan& plan(const double* user, int copy);
  void follow(double* user, const Step& step, Plan& plan);
  void start(double* user, const Plan& plan) const;

  std::vector<int> joints_;
  std::vector<int> actuators_;
  int address_;
  MotionLimits limits_;
  std::vector<std::unique_ptr<Plan>> plans_;  // one per copy
};

}  // namespace rcs
