// The interface of forward and inverse kinematics of one arm, and the backend on MuJoCo's Jacobians.
#pragma once

#include <mujoco/mujoco.h>

#include <array>
#include <cstdint>
#include <limits>
#include <memory>
#include <mutex>
#include <span>
#include <string>
#include <vector>

#include "rcs/pose.hpp"
#include "rcs/result.hpp"

namespace rcs {

/// The answer of inverse kinematics.
struct IkResult {
  std::vector<double> joints;  ///< rad, always inside the joint limits
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
  /// Largest change of any joint from the start [rad]; a solution farther away is `clamped` to this step towards it.
  double max_step = std::numeric_limits<double>::infinity();
  std::uint64_t seed = 0;  ///< of the restarts: same seed, same answer
};

/// Kinematics of one arm: TCP pose in the base frame from joints, and back. Implementable in C++ and Python.
class Kinematics {
 public:
  virtual ~Kinematics() = default;
  virtual int dof() const = 0;
  /// Pose of the TCP in the base frame for joints [rad].
  virtual Pose forward(std::span<const double> joints) = 0;
  /// Joints that bring the TCP to `target` (in the base frame), looked for from `start` [rad].
  virtual IkResult inverse(const Pose& target, std::span<const double> start, const IkOptions& options) = 0;
};

/// Many targets at once. Row i of every output depends on row i of the inputs alone, at any number of threads.
///
/// `targets` is count × 7 (translation, quaternion xyzw), `starts` and `joints` are count × dof, `status` is count
/// long.
class DampedLeastSquares;
void inverse_batch(DampedLeastSquares& kinematics, std::span<const double> targets, std::span<const double> starts,
                   const IkOptions& options, int threads, std::span<double> joints, std::span<std::uint8_t> status);

/// Damped least squares on MuJoCo Jacobians, with the joint limits inside the solve.
///
/// Joints that would leave their range are fixed at the limit and the step is solved again for the others. Nakamura and
/// Hanafusa, "Inverse kinematic solutions with singularity robustness for robot manipulator control", 1986.
///
/// Calls from several threads are as good as one after the other: each computes in memory of its own, which is kept for
/// the next call.
class DampedLeastSquares final : public Kinematics {
 public:
  /// `model` is copied. `joints` are joint ids base to tip, `tcp_site` and `base_body` ids in it.
  DampedLeastSquares(const mjModel* model, std::vector<int> joints, int tcp_site, int base_body);
  ~DampedLeastSquares() override;

  int dof() const override { return static_cast<int>(joints_.size()); }
  Pose forward(std::span<const double> joints) override;
  IkResult inverse(const Pose& target, std::span<const double> start, const IkOptions& options) override;

  /// Jacobian of the TCP in the base frame: 6 × dof, row-major, translation rows [m/rad] above rotation rows [rad/rad].
  std::vector<double> jacobian(std::span<const double> joints) const;

  const std::vector<double>& joint_lower() const { return lower_; }
  const std::vector<double>& joint_upper() const { return upper_; }

 private:
  /// What one call computes in.
  struct Scratch;
  struct GiveBack {
    const DampedLeastSquares* owner;
    void operator()(Scratch* scratch) const;
  };
  using Lease = std::unique_ptr<Scratch, GiveBack>;

  Lease borrow() const;
  void set_joints(Scratch& scratch, std::span<const double> joints) const;
  void check_size(std::span<const double> joints) const;
  bool attempt(Scratch& scratch, const std::array<double, 7>& target, std::vector<double>& q, const IkOptions& options,
               IkResult& result) const;
  /// Position error and rotation error (as a rotation vector) from the present TCP to the target, in world axes.
  void error_to(const Scratch& scratch, const std::array<double, 7>& target_in_world,
                std::array<double, 6>& error) const;

  mjModel* model_ = nullptr;
  std::vector<int> joints_;
  std::vector<int> qpos_;
  std::vector<int> dofs_;
  std::vector<double> lower_;
  std::vector<double> upper_;
  int tcp_site_;
  int base_body_;
  mutable std::mutex mutex_;
  mutable std::vector<std::unique_ptr<Scratch>> unused_;
  mutable std::size_t scratch_count_ = 0;
};

}  // namespace rcs
