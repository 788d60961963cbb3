#include "rcs/kinematics.hpp"

#include <algorithm>
#include <cmath>

#include "over_rows.hpp"

namespace rcs {

namespace {

constexpr double kDifference = 1e-6;  // rad; error of a central difference in double precision is least near here

}  // namespace

void Kinematics::check_joints(std::span<const double> joints) const {
  const auto n = static_cast<std::size_t>(dof());
  if (joints.size() != n)
    throw InvalidSetup("kinematics: " + std::to_string(joints.size()) + " joints given, the arm has " +
                       std::to_string(n));
  for (const double q : joints)
    if (!std::isfinite(q)) throw InvalidSetup("kinematics: a joint is not finite");
}

void Kinematics::check_options(const IkOptions& options) const {
  const auto n = static_cast<std::size_t>(dof());
  for (const auto* rows : {&options.max_step, &options.preferred})
    if (!rows->empty() && rows->size() != n)
      throw InvalidSetup("inverse kinematics: max_step and preferred must have one entry for each of the " +
                         std::to_string(n) + " joints or none, one has " + std::to_string(rows->size()));
}

std::array<std::vector<double>, 2> Kinematics::joint_range() const {
  std::array<std::vector<double>, 2> range{joint_lower(), joint_upper()};
  const auto n = static_cast<std::size_t>(dof());
  for (const auto& limits : range)
    if (limits.size() != n)
      throw InvalidSetup("kinematics: there are " + std::to_string(limits.size()) + " limits, the arm has " +
                         std::to_string(n) + " joints");
  return range;
}

std::vector<double> Kinematics::jacobian(std::span<const double> joints) {
  check_joints(joints);
  const std::size_t n = joints.size();
  std::vector<double> jacobian(6 * n), moved(joints.begin(), joints.end());
  for (std::size_t c = 0; c < n; ++c) {
    moved[c] = joints[c] + kDifference;
    const Pose after = forward(moved);
    moved[c] = joints[c] - kDifference;
    const Pose before = forward(moved);
    moved[c] = joints[c];
    const auto turn = (after * before.inverse()).quaternion();
    const double sign = turn[3] < 0.0 ? -1.0 : 1.0;
    for (std::size_t r = 0; r < 3; ++r) {
      jacobian[r * n + c] = (after.translation()[r] - before.translation()[r]) / (2 * kDifference);
      jacobian[(r + 3) * n + c] = sign * turn[r] / kDifference;  // the rotation vector is twice the quaternion's part
    }
  }
  return jacobian;
}

void Kinematics::forward_batch(std::span<const double> joints, std::span<double> poses) {
  const std::size_t n = static_cast<std::size_t>(dof()), count = poses.size() / 7;
  if (poses.size() % 7 != 0 || joints.size() != n * count)
    throw InvalidSetup("kinematics: joints and poses have different numbers of rows");
  for (std::size_t i = 0; i < count; ++i) {
    const Pose pose = forward(joints.subspan(i * n, n));
    std::copy_n(pose.translation().begin(), 3, poses.begin() + static_cast<std::ptrdiff_t>(7 * i));
    std::copy_n(pose.quaternion().begin(), 4, poses.begin() + static_cast<std::ptrdiff_t>(7 * i + 3));
  }
}

void Kinematics::inverse_batch(std::span<const double> targets, std::span<const double> starts,
                               const IkOptions& options, int, std::span<double> joints, std::span<std::uint8_t> status,
                               std::span<double> errors) {
  solve_rows(targets, starts, options, 1, joints, status, errors);
}

void Kinematics::solve_rows(std::span<const double> targets, std::span<const double> starts, const IkOptions& options,
                            int threads, std::span<double> joints, std::span<std::uint8_t> status,
                            std::span<double> errors) {
  const std::size_t n = static_cast<std::size_t>(dof()), count = status.size();
  if (targets.size() != 7 * count || starts.size() != n * count || joints.size() != n * count ||
      errors.size() != 2 * count)
    throw InvalidSetup("inverse kinematics: targets, starts and outputs have different numbers of rows");
  // All poses are made first: a bad one throws here and not in a thread.
  std::vector<Pose> poses;
  poses.reserve(count);
  for (std::size_t i = 0; i < count; ++i) {
    const double* t = targets.data() + 7 * i;
    poses.emplace_back(std::array<double, 3>{t[0], t[1], t[2]}, std::array<double, 4>{t[3], t[4], t[5], t[6]});
  }
  const std::vector<double> from(starts.begin(), starts.end());  // nobody writes to a copy once it is checked
  for (const double q : from)
    if (!std::isfinite(q)) throw InvalidSetup("inverse kinematics: a start joint is not finite");
  over_rows(count, threads, [&](std::size_t i) {
    const IkResult result = inverse(poses[i], std::span(from).subspan(i * n, n), options);
    if (result.joints.size() != n) throw InvalidSetup("inverse kinematics: the answer has a wrong number of joints");
    std::copy(result.joints.begin(), result.joints.end(), joints.begin() + static_cast<std::ptrdiff_t>(i * n));
    status[i] = static_cast<std::uint8_t>(result.status);
    errors[2 * i] = result.translation_error;
    errors[2 * i + 1] = result.rotation_error;
  });
}

}  // namespace rcs
