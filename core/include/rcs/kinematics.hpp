// The interface of forward and inverse kinematics of one arm, and the solver of every arm that a model describes.
#pragma once

#include <mujoco/mujoco.h>

#include <array>
#include <cstdint>
#include <memory>
#include <mutex>
#include <span>
#include <string>
#include <vector>

#include "rcs/pose.hpp"
#include "rcs/result.hpp"

namespace rcs {

class SerialChain;

/// The answer of inverse kinematics.
struct IkResult {
  /// rad, inside the joint limits; of a joint that was outside at the start of a motion, no farther out than there
  std::vector<double> joints;
  IkStatus status = IkStatus::infeasible;
  double translation_error = 0.0;  ///< m, of the best solution found, before any clamping
  double rotation_error = 0.0;     ///< rad, likewise
  int iterations = 0;              ///< over all restarts
};

/// How hard inverse kinematics tries, and what it may answer.
struct IkOptions {
  double translation_tolerance = 1e-4;  ///< m
  double rotation_tolerance = 1e-4;     ///< rad
  int iterations = 30;                  ///< per attempt
  int restarts = 60;                    ///< further attempts from random joints; 0 keeps to the branch of the start
  double damping = 1e-4;                ///< of the least squares; smaller is faster and wilder near singularities
  /// How much a radian counts against a metre. Below 1 an arm with fewer than six joints meets the translation and
  /// comes as near to the rotation as it can; `rotation_tolerance` says how near is near enough.
  double rotation_weight = 1.0;
  /// Largest change of each joint from the start [rad], one entry per joint; empty for no bound. A solution farther
  /// away is `clamped`: all joints go the same share of the way towards it.
  std::vector<double> max_step = {};
  /// Joints [rad] that an arm with more joints than it needs returns to without moving its TCP; empty for none.
  std::vector<double> preferred = {};
  /// How strongly it is drawn there: share of the way back per radian that the fastest joint moves for the TCP. It
  /// depends on the path alone, not on the number of solves along it, and a TCP at rest means an arm at rest.
  double preferred_weight = 2.0;
  /// Follow the target: out of reach, answer with the `nearest` pose instead of the start, and beyond `max_step`
  /// with a step in the direction of the target. Everything that the target leaves unchanged is kept: a push against
  /// the end of the reach does not turn the tool, and a turn against a joint's limit does not move it. A joint that
  /// starts outside its limits goes no farther out, and need not come back.
  bool best_effort = false;
  std::uint64_t seed = 0;  ///< of the restarts: same seed, same answer
};

/// How joints may move for a twist of the TCP.
struct VelocityOptions {
  /// Largest speed of each joint [rad/s], one entry per joint; empty for no bound. All joints are slowed down alike, so
  /// that the TCP keeps its direction.
  std::vector<double> max_velocity = {};
  /// As in `IkOptions`.
  std::vector<double> preferred = {};
  double preferred_weight = 2.0;
  /// How near a singular posture joints are slowed down [m/rad]: where the TCP moves by less than this when the joints
  /// move by one radian, in the direction in which it does. No more than 1 / damping rad/s answer to 1 m/s.
  double damping = 0.03;
};

/// Joint velocities for a twist.
struct Velocities {
  std::vector<double> joints;      ///< rad/s
  IkStatus status = IkStatus::ok;  ///< `clamped`: slower, the same way; `nearest`: the TCP moves otherwise than asked
  double share = 1.0;              ///< of the speed, 0 … 1; below 1 where a joint is as fast as it may be
  double translation_error = 0.0;  ///< m/s, between what is asked, at this share, and what the joints do
  double rotation_error = 0.0;     ///< rad/s, likewise
};

/// Kinematics of one arm: TCP pose in the base frame from joints, and back. Implementable in C++ and Python.
class Kinematics {
 public:
  virtual ~Kinematics() = default;
  virtual int dof() const = 0;
  virtual std::vector<double> joint_lower() const = 0;  ///< rad
  virtual std::vector<double> joint_upper() const = 0;  ///< rad
  /// Pose of the TCP in the base frame for joints [rad].
  virtual Pose forward(std::span<const double> joints) = 0;
  /// Joints that bring the TCP to `target` (in the base frame), looked for from `start` [rad]. Unless overridden,
  /// damped least squares by `forward` and `jacobian`, as of `DampedLeastSquares`.
  virtual IkResult inverse(const Pose& target, std::span<const double> start, const IkOptions& options);
  /// Jacobian of the TCP in the base frame: 6 × dof, row-major, translation rows [m/rad] above rotation rows [rad/rad].
  /// Unless overridden, central differences of `forward`.
  virtual std::vector<double> jacobian(std::span<const double> joints);
  /// TCP poses, count × 7 (translation, quaternion xyzw), for joints, count × dof. Unless overridden, a loop.
  virtual void forward_batch(std::span<const double> joints, std::span<double> poses);
  /// Many targets at once. Row i of every output depends on row i of the inputs alone, at any number of threads.
  ///
  /// `targets` is count × 7 (translation, quaternion xyzw), `starts` and `joints` are count × dof, `status` is count
  /// long, `errors` count × 2: what is left of translation [m] and rotation [rad], as `IkResult` has it. Unless
  /// overridden, a loop in the thread of the caller.
  virtual void inverse_batch(std::span<const double> targets, std::span<const double> starts, const IkOptions& options,
                             int threads, std::span<double> joints, std::span<std::uint8_t> status,
                             std::span<double> errors);

  /// Joint velocities that move the TCP at a twist: linear [m/s] above angular velocity [rad/s], in the base frame.
  Velocities velocities(std::span<const double> joints, std::span<const double, 6> twist,
                        const VelocityOptions& options);
  /// Joints after the TCP has moved at a twist for `duration` [s]: along a straight line, turning about one axis. The
  /// residual is what the TCP's pose lacks of it; `clamped` means that it went slower, the same way, `nearest` that a
  /// singular posture or a joint's limit made it go another. Joints that start outside their limits go no farther out.
  /// Zero twist leaves all as they are.
  IkResult advance(std::span<const double> joints, std::span<const double, 6> twist, double duration,
                   const VelocityOptions& options);
  /// Many at once: `starts` and `joints` are count × dof, `twists` count × 6, the others as for `inverse_batch`. On one
  /// thread unless several may call `forward` and `jacobian` at once.
  void advance_batch(std::span<const double> starts, std::span<const double> twists, double duration,
                     const VelocityOptions& options, int threads, std::span<double> joints,
                     std::span<std::uint8_t> status, std::span<double> errors);

 protected:
  /// True if several threads may call at once.
  virtual bool is_thread_safe() const { return false; }
  /// Solve the rows of a batch, whose shapes and numbers are checked, on at most `threads` threads.
  void solve_rows(std::span<const double> targets, std::span<const double> starts, const IkOptions& options,
                  int threads, std::span<double> joints, std::span<std::uint8_t> status, std::span<double> errors);
  /// Throws `InvalidSetup` for a wrong number of joints and for one that is not finite.
  void check_joints(std::span<const double> joints) const;
  /// Throws `InvalidSetup` for options of another number of joints.
  void check_options(const IkOptions& options) const;
  /// Lower and upper limits. Throws `InvalidSetup` unless each joint has both.
  std::array<std::vector<double>, 2> joint_range() const;
};

/// Damped least squares on a chain of hinges and slides, with the joint limits inside the solve.
///
/// With best effort, a step that comes less near than its Jacobian promises is made again with more damping
/// (Levenberg-Marquardt), so that the error never grows and a stretched arm does not swing to and fro. Joints that
/// would leave their range are fixed at the limit and the step is solved again for the others. Nakamura and Hanafusa,
/// "Inverse kinematic solutions with singularity robustness for robot manipulator control", 1986; the pull to the
/// preferred joints is projected into the null space, Liegeois, "Automatic supervisory control of the configuration and
/// behavior of multibody mechanisms", 1977.
///
/// Calls from several threads are as good as one after the other: each computes in memory of its own, which is kept for
/// the next call.
class DampedLeastSquares final : public Kinematics {
 public:
  /// `joints` are joint ids of `model` from base to tip, `tcp_site` and `base_body` ids in it. The model is not kept.
  DampedLeastSquares(const mjModel* model, std::vector<int> joints, int tcp_site, int base_body);
  ~DampedLeastSquares() override;

  int dof() const override { return static_cast<int>(joints_.size()); }
  std::vector<double> joint_lower() const override { return lower_; }
  std::vector<double> joint_upper() const override { return upper_; }
  Pose forward(std::span<const double> joints) override;
  IkResult inverse(const Pose& target, std::span<const double> start, const IkOptions& options) override;
  std::vector<double> jacobian(std::span<const double> joints) override;
  void inverse_batch(std::span<const double> targets, std::span<const double> starts, const IkOptions& options,
                     int threads, std::span<double> joints, std::span<std::uint8_t> status,
                     std::span<double> errors) override;

 protected:
  bool is_thread_safe() const override { return true; }

 private:
  /// The memory in which a call computes.
  struct Scratch;
  struct GiveBack {
    const DampedLeastSquares* owner;
    void operator()(Scratch* scratch) const;
  };
  using Lease = std::unique_ptr<Scratch, GiveBack>;
  Lease borrow() const;

  std::vector<int> joints_;
  std::unique_ptr<const SerialChain> chain_;
  std::vector<double> lower_;
  std::vector<double> upper_;
  mutable std::mutex mutex_;
  mutable std::vector<std::unique_ptr<Scratch>> unused_;
  mutable std::size_t scratch_count_ = 0;
};

}  // namespace rcs
