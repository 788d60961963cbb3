// Measurements after a physics step: torques at the joints, the wrench on the tool, touching fingers, how objects
// move.
#pragma once

#include <mujoco/mujoco.h>

#include <array>
#include <cstdint>
#include <span>
#include <vector>

namespace rcs {

/// Values that a world reads out of every copy after each step. Called by several threads at once.
class Measurement {
 public:
  virtual ~Measurement() = default;
  /// Number of values.
  virtual int size() const = 0;
  /// Write the values of the last physics step.
  virtual void read(const mjModel* model, const mjData* data, std::span<double> values) const = 0;
  /// Throws `InvalidSetup` if it was made for another model.
  virtual void check(const mjModel* model) const = 0;
  /// True if it reads forces, for which all of a state must be computed anew after it was written to.
  virtual bool needs_forces() const { return true; }
};

/// A serial arm in a model, and what presses on it from outside: contacts with anything but the arm and its tool, and
/// the forces of `xfrc_applied`. The forces with which a gripper holds an object cancel out; the object's weight stays.
class ArmBody {
 public:
  /// `joints` are hinge or slide joint ids from base to tip, `tcp_site` is beyond the last one, and `frame_body` is the
  /// body whose axes wrenches have. Throws `InvalidSetup` if one of them is not in the model.
  ArmBody(const mjModel* model, std::vector<int> joints, int tcp_site, int frame_body);

  int dof() const { return static_cast<int>(joints_.size()); }
  double timestep() const { return timestep_; }  ///< s, of the model
  /// Throws `InvalidSetup` if it was made for another model.
  void check(const mjModel* model) const;
  /// Torques [Nm, N] that hold the arm against its own weight and whatever presses on it: what its drives exert.
  void drive_torques(const mjModel* model, const mjData* data, std::span<double> torques) const;
  /// Torques [Nm, N] of outer forces at the joints (transposed Jacobian), and two wrenches (force [N], moment about the
  /// TCP [Nm]) in the axes of the frame body: of what presses on the tool, and on all moving links. Returns whether
  /// anything does; without it all values are 0.
  bool outer_loads(const mjModel* model, const mjData* data, std::span<double> torques, std::span<double, 6> on_tool,
                   std::span<double, 6> on_arm) const;

  static constexpr std::size_t kMostJoints = 32;

 private:
  std::uint64_t signature_;  // of the model
  double timestep_;
  std::vector<int> joints_;
  std::vector<int> level_;  // of each body: how many of the joints move it; -1 for bodies that are not the arm's
  std::vector<int> level_of_geom_;
  std::vector<int> moving_;  // bodies that a joint moves
  int tcp_site_;
  int frame_body_;
};

/// The torques of an arm's drives, then the wrench on its tool.
class ArmLoads final : public Measurement {
 public:
  explicit ArmLoads(ArmBody arm) : arm_(std::move(arm)) {}
  int size() const override { return arm_.dof() + 6; }
  void read(const mjModel* model, const mjData* data, std::span<double> values) const override;
  void check(const mjModel* model) const override { arm_.check(model); }

 private:
  ArmBody arm_;
};

/// Which fingers touch something with at least a force (1 or 0 each), then whether two of them touch the same object.
class FingerContacts final : public Measurement {
 public:
  /// `fingers` hold one flag per geom each, `own` flags of the robot's own geoms, which do not count as touched;
  /// `force` is in N. A geom that cannot move is touched, but is no object to be grasped. Throws `InvalidSetup` for
  /// flags of another model.
  FingerContacts(const mjModel* model, const std::vector<std::vector<std::uint8_t>>& fingers,
                 const std::vector<std::uint8_t>& own, double force);
  int size() const override { return fingers_ + 1; }
  void read(const mjModel* model, const mjData* data, std::span<double> values) const override;
  void check(const mjModel* model) const override;

 private:
  struct Touch {
    int finger = -1;  // none
    int object = -1;  // a kinematic tree, or their number + a flex; -1: something that cannot move
  };
  Touch touch_of(const mjModel* model, const mjContact& contact) const;
  double force_of(const mjModel* model, const mjData* data, Touch touch, int first) const;

  std::uint64_t signature_;  // of the model
  int fingers_;
  std::vector<int> finger_of_geom_;  // -1: of none
  std::vector<std::uint8_t> own_;
  double force_;
};

/// Velocity [m/s] of the origin of a body with a free joint, then its angular velocity [rad/s], in the axes of a frame
/// body that stands still.
class FreeBodyVelocity final : public Measurement {
 public:
  /// Throws `InvalidSetup` if the joint is no free joint or the frame is not in the model.
  FreeBodyVelocity(const mjModel* model, int joint, int frame_body);
  int size() const override { return 6; }
  void read(const mjModel* model, const mjData* data, std::span<double> values) const override;
  void check(const mjModel* model) const override;
  bool needs_forces() const override { return false; }

 private:
  std::uint64_t signature_;  // of the model
  int qpos_;                 // of the quaternion
  int dof_;
  int frame_body_;
};

}  // namespace rcs
