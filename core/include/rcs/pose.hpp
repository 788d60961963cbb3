// The pose: a rigid transform in SE(3), as an immutable value.
#pragma once

#include <array>
#include <cstddef>
#include <functional>
#include <span>
#include <string>

namespace rcs {

/// Reorder a quaternion from MuJoCo's wxyz to the xyzw of every public edge.
constexpr std::array<double, 4> wxyz_to_xyzw(const std::array<double, 4>& q) { return {q[1], q[2], q[3], q[0]}; }
/// Reorder a quaternion from xyzw to MuJoCo's wxyz.
constexpr std::array<double, 4> xyzw_to_wxyz(const std::array<double, 4>& q) { return {q[3], q[0], q[1], q[2]}; }

/// Scale a quaternion (either order) to norm 1.
///
/// Throws std::invalid_argument if it is not finite, or if every component is below 1e-9: too short to have a
/// direction.
std::array<double, 4> normalize_quaternion(const std::array<double, 4>& quaternion);

/// A translation [m] and a rotation: the pose of one frame in another, or a rigid motion.
///
/// The quaternion is xyzw, of norm 1 and with w >= 0 (for w = 0 its first other component is positive), so one rotation
/// has one quaternion, and equal poses have equal bits. Nothing changes a pose once it is made.
///
/// Making a pose from numbers throws std::invalid_argument if one is not finite or if they are no rotation: a
/// quaternion may be 1e-3 off norm 1 (it is normalised), the entries of a matrix 1e-6 off orthonormal. Working with
/// poses never throws.
class Pose {
 public:
  /// The identity.
  Pose() noexcept = default;
  /// From a translation [m] and a quaternion xyzw.
  explicit Pose(const std::array<double, 3>& translation, const std::array<double, 4>& quaternion = {0, 0, 0, 1});

  /// From a translation [m] and a quaternion xyzw: the constructor, under the name that says the representation.
  static Pose from_quaternion(const std::array<double, 3>& translation, const std::array<double, 4>& quaternion);
  /// From a translation [m] and MuJoCo's quaternion wxyz.
  static Pose from_wxyz(const std::array<double, 3>& translation, const std::array<double, 4>& quaternion);
  /// From a homogeneous 4 × 4 matrix, row-major.
  static Pose from_matrix(std::span<const double, 16> matrix);
  /// From a translation [m] and roll, pitch, yaw [rad] about the fixed x, y, z axes, in that order.
  static Pose from_rpy(const std::array<double, 3>& translation, const std::array<double, 3>& rpy);
  /// From a translation [m] and a rotation vector: the axis times the angle [rad].
  static Pose from_rotvec(const std::array<double, 3>& translation, const std::array<double, 3>& rotvec);
  /// From translation [m] and quaternion xyzw in one array.
  static Pose from_tquat(std::span<const double, 7> tquat);
  /// From translation [m] and roll, pitch, yaw [rad] in one array.
  static Pose from_xyzrpy(std::span<const double, 6> xyzrpy);
  /// The motion after one second at a constant twist [v m/s, w rad/s] of the moving frame; the inverse of `log`.
  ///
  /// Solà, Deray, Atchuthan, "A micro Lie theory for state estimation in robotics", 2018, appendices B and D.
  static Pose exp(std::span<const double, 6> twist);

  /// Translation, m.
  const std::array<double, 3>& translation() const& noexcept { return translation_; }
  std::array<double, 3> translation() && noexcept { return translation_; }  // a pose that is gone next leaves a copy
  /// Unit quaternion xyzw with w >= 0.
  const std::array<double, 4>& quaternion() const& noexcept { return quaternion_; }
  std::array<double, 4> quaternion() && noexcept { return quaternion_; }  // a pose that is gone next leaves a copy
  /// The same quaternion in MuJoCo's order.
  std::array<double, 4> wxyz() const noexcept { return xyzw_to_wxyz(quaternion_); }
  /// Homogeneous 4 × 4 matrix, row-major.
  std::array<double, 16> matrix() const noexcept;
  /// Roll, pitch, yaw [rad] about the fixed x, y, z axes: roll and yaw in (-pi, pi], pitch in [-pi/2, pi/2].
  ///
  /// At a pitch of ±pi/2 only the sum or the difference of roll and yaw is determined; roll is 0 there. Accurate at
  /// every pitch, unlike the arcsine of a matrix entry: Bernardes and Viollet, "Quaternion to Euler angles conversion",
  /// 2022.
  std::array<double, 3> rpy() const noexcept;
  /// Rotation vector: axis times angle [rad], the angle in [0, pi].
  std::array<double, 3> rotvec() const noexcept;
  /// Translation [m] and quaternion xyzw in one array.
  std::array<double, 7> tquat() const noexcept;
  /// Translation [m] and roll, pitch, yaw [rad] in one array.
  std::array<double, 6> xyzrpy() const noexcept;
  /// The twist [v, w] that reaches this pose from the identity in one second, |w| in [0, pi]; the inverse of `exp`.
  std::array<double, 6> log() const noexcept;

  /// This motion after `right`: the pose of C in A from those of B in A (this) and C in B.
  Pose operator*(const Pose& right) const noexcept;
  /// The pose of A in B from that of B in A.
  Pose inverse() const noexcept;
  /// A point given in this frame [m], in the frame that this pose is in.
  std::array<double, 3> apply(const std::array<double, 3>& point) const noexcept;
  /// The pose a fraction of the way to another: straight line and shortest rotation (slerp), both at constant speed.
  ///
  /// Fractions 0 and 1 give the end points to the bit; one outside [0, 1] throws std::invalid_argument.
  Pose interpolate(const Pose& to, double fraction) const;

  /// Angle of the rotation to another pose [rad], in [0, pi].
  double angle_to(const Pose& other) const noexcept;
  /// Distance of the origin to that of another pose, m.
  double distance_to(const Pose& other) const noexcept;
  /// True if another pose is within a distance [m] and an angle [rad].
  bool is_close(const Pose& other, double metres, double radians) const noexcept;
  /// True if every bit is the same.
  bool operator==(const Pose& other) const noexcept = default;

 private:
  friend Pose limit_step(const Pose& start, const Pose& goal, double max_translation, double max_rotation);
  static Pose unchecked(const std::array<double, 3>& translation, const std::array<double, 4>& quaternion) noexcept;

  std::array<double, 3> translation_{0, 0, 0};
  std::array<double, 4> quaternion_{0, 0, 0, 1};
};

/// The pose nearest to `goal` within a distance [m] and an angle [rad] of `start`.
///
/// Each limit clips its own part: a long way to go does not slow the rotation, nor the reverse. A goal within both
/// comes back to the bit. Throws std::invalid_argument for a limit below 0 or NaN; infinity is no limit.
Pose limit_step(const Pose& start, const Pose& goal, double max_translation, double max_rotation);

/// "Pose(translation=(x, y, z), quaternion=(x, y, z, w))", with the digits that give back the same bits.
std::string to_string(const Pose& pose);

}  // namespace rcs

/// Equal poses have equal hashes.
template <>
struct std::hash<rcs::Pose> {
  std::size_t operator()(const rcs::Pose& pose) const noexcept;
};
