// How simulated joints are led to their targets: along trajectories, by servos, within their torques.
#pragma once

#include <mujoco/mujoco.h>

#include <memory>
#include <optional>
#include <span>
#include <vector>

#include "rcs/callback.hpp"
#include "rcs/trajectory.hpp"

namespace rcs {

class TcpSprings;

/// The compliance of an arm that is pushed, six numbers each: along x, y, z of the base [N/m, N·s/m], about them
/// [N·m/rad, N·m·s/rad]. Where they are empty, the gains of the position servos are the springs and dampers of the
/// joints.
struct Springs {
  std::vector<double> stiffness;
  std::vector<double> damping;
  int tcp_site = -1;
  int base_body = -1;
};

/// Moves position servos of some joints to a target, in each copy of a world, along a `Trajectory`.
///
/// A motion that would take more torque than the motors have beside gravity (that of a declared load, too) is
/// made with less acceleration, as much as inverse dynamics ask for. Besides the position, the servo is given the
/// velocity and the force of the acceleration, so that it does not lag behind. An arm that is kept from following is
/// not run away from: its trajectory begins anew at most 0.2 rad from it.
///
/// An arm with springs gives way, at its joints or at its TCP; the forces that acceleration and speed take come on top.
/// It has arrived when it stands where its springs let it, however far it is pushed. It goes on from where it was led,
/// not from where it is, unless they are more than 1 rad apart.
///
/// All that the motion remembers is in the copy's `mjData.userdata`: a state that is saved and restored goes on with
/// the same bits.
///
/// As a callback, it is true when the joints stand at their target.
class Motion final : public StepCallback {
 public:
  using Step = Trajectory::Step;

  /// `joints` are hinge or slide joint ids, base to tip, `actuators` their position servos, `address` the first of the
  /// `Trajectory::size(joints.size())` numbers in `mjData.userdata`. With springs of the TCP, the actuators are motors.
  /// Throws `InvalidSetup` if they do not fit each other.
  Motion(std::vector<int> joints, std::vector<int> actuators, int address, MotionLimits limits, int copies,
         std::optional<Springs> springs = std::nullopt);
  Motion(const Motion&) = delete;
  Motion& operator=(const Motion&) = delete;
  ~Motion() override;

  int dof() const { return static_cast<int>(joints_.size()); }
  int address() const { return address_; }
  const std::vector<int>& joints() const { return joints_; }
  const MotionLimits& limits() const { return limits_; }
  bool gives_way() const { return springs_.has_value(); }
  /// True if the trajectory in this memory of a copy has come to its target.
  bool has_ended(const double* memory, int copy);

  /// Plan the motion of a step. The target is what was written into the first `dof` numbers. Joints that are to hold
  /// brake; those that are not where they were led to begin anew from where they are measured.
  void begin(const mjModel* model, mjData* data, int copy, const Step& step);
  /// Write the controls of the next physics step.
  void advance(const mjModel* model, mjData* data, int copy);
  /// The present reference of the joints: positions, velocities and accelerations, `dof` numbers each.
  std::vector<double> state(const mjData* data, int copy);
  /// Time until the joints are to stand still [s].
  double remaining(const mjData* data, int copy);

  /// The effect of a step to a target: where the joints are led to, `dof` numbers each, from now to the end of the step
  /// and while they brake to rest from there, at most every `tick` [s] and at the same times for all motions; in a
  /// synchronous step, until they stand. Without a target, they hold. Nothing changes but what is derived
  /// in `data`.
  std::vector<double> preview(const mjModel* model, mjData* data, int copy, const Step& step,
                              std::span<const double> target, double tick);

  bool call(const StepView& view) override;
  void check(const mjModel* model, int copies) const override;

 private:
  struct Copy;

  void plan(const mjModel* model, mjData* data, double* memory, Copy& copy, const Step& step);
  void brake(const mjModel* model, mjData* data, double* memory, Copy& copy);
  bool is_astray(const mjModel* model, const mjData* data, const double* memory, Copy& copy, double tolerance) const;
  double share_of_acceleration(const mjModel* model, mjData* data, const double* memory, Copy& copy, bool is_far);
  bool is_of_tcp() const { return springs_ && !springs_->stiffness.empty(); }
  void give_way(const mjModel* model, mjData* data, Copy& copy, bool was_still);
  static void know_forces(const mjModel* model, mjData* data, Copy& copy);
  static void know_bias(const mjModel* model, mjData* data, Copy& copy);
  static void know_speed_forces(const mjModel* model, mjData* data, Copy& copy);
  static void look_at_inertia(const mjModel* model, mjData* data);
  void put_joints(const mjModel* model, mjData* data, const Trajectory& trajectory);

  std::vector<int> joints_;
  std::vector<int> actuators_;
  int address_;
  MotionLimits limits_;
  std::optional<Springs> springs_;
  std::vector<std::unique_ptr<Copy>> copies_;
};

}  // namespace rcs
