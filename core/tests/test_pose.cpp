// Laws of poses: the group axioms, round trips of every representation, interpolation, limits and refusals.
#include <array>
#include <cmath>
#include <functional>
#include <limits>
#include <numbers>
#include <random>
#include <stdexcept>

#include "check.hpp"
#include "rcs/pose.hpp"

namespace {

using rcs::Pose;

constexpr double kPi = std::numbers::pi;
constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();

// Rotations of every size, as most uniformly drawn ones are large.
Pose random_pose(std::mt19937& generator) {
  std::normal_distribution<double> normal;
  std::uniform_real_distribution<double> exponent(-12, 0);
  const double size = kPi * std::pow(10.0, exponent(generator));
  std::array<double, 3> axis{normal(generator), normal(generator), normal(generator)};
  const double length = std::sqrt(axis[0] * axis[0] + axis[1] * axis[1] + axis[2] * axis[2]);
  for (double& component : axis) component *= size / length;
  return Pose::from_rotvec({normal(generator), normal(generator), normal(generator)}, axis);
}

void test_group_axioms(const Pose& a, const Pose& b, const Pose& c) {
  CHECK((a * Pose()).is_close(a, 1e-14, 1e-14));
  CHECK((Pose() * a).is_close(a, 1e-14, 1e-14));
  CHECK((a * a.inverse()).is_close(Pose(), 1e-13, 1e-13));
  CHECK(((a * b) * c).is_close(a * (b * c), 1e-13, 1e-13));
  CHECK((a * b).inverse().is_close(b.inverse() * a.inverse(), 1e-13, 1e-13));
  const auto once = (a * b).apply({0.1, -0.2, 0.3});
  const auto twice = a.apply(b.apply({0.1, -0.2, 0.3}));
  for (int i = 0; i < 3; ++i) CHECK_NEAR(once[i], twice[i], 1e-13);
}

void test_round_trips(const Pose& pose) {
  CHECK(Pose::from_tquat(pose.tquat()) == pose);
  CHECK(Pose::from_wxyz(pose.translation(), pose.wxyz()) == pose);
  CHECK(Pose::from_quaternion(pose.translation(), pose.quaternion()) == pose);
  CHECK(Pose::from_matrix(pose.matrix()).is_close(pose, 0, 1e-14));
  CHECK(Pose::from_xyzrpy(pose.xyzrpy()).is_close(pose, 0, 1e-14));
  CHECK(Pose::from_rotvec(pose.translation(), pose.rotvec()).is_close(pose, 0, 1e-14));
  CHECK(Pose::exp(pose.log()).is_close(pose, 1e-12, 1e-12));
  CHECK(pose.quaternion()[3] >= 0);
  CHECK(std::hash<Pose>{}(pose) == std::hash<Pose>{}(Pose::from_tquat(pose.tquat())));
}

void test_steps(const Pose& a, const Pose& b) {
  CHECK(a.interpolate(b, 0) == a);
  CHECK(a.interpolate(b, 1) == b);
  CHECK_NEAR(a.distance_to(a.interpolate(b, 0.25)), 0.25 * a.distance_to(b), 1e-13);
  CHECK_NEAR(a.angle_to(a.interpolate(b, 0.25)), 0.25 * a.angle_to(b), 1e-13);
  const Pose step = rcs::limit_step(a, b, 0.1, 0.2);
  CHECK_NEAR(a.distance_to(step), std::min(0.1, a.distance_to(b)), 1e-13);
  CHECK_NEAR(a.angle_to(step), std::min(0.2, a.angle_to(b)), 1e-13);
  CHECK(rcs::limit_step(a, b, 100, 4) == b);
}

void test_half_turns() {
  for (const double angle : {kPi, kPi - 1e-9, kPi - 1e-15, -kPi}) {
    const Pose pose = Pose::from_rotvec({1, 2, 3}, {0, angle, 0});
    CHECK(Pose::exp(pose.log()).is_close(pose, 1e-12, 1e-12));
    CHECK_NEAR(std::abs(pose.rotvec()[1]), std::abs(angle), 1e-14);
  }
  CHECK(Pose({0, 0, 0}, {-1, 0, 0, 0}) == Pose({0, 0, 0}, {1, 0, 0, 0}));
}

void test_gimbal_lock() {
  for (const double pitch : {kPi / 2, -kPi / 2}) {
    const Pose pose = Pose::from_rpy({}, {0.3, pitch, 0.5});
    const auto rpy = pose.rpy();
    CHECK(rpy[0] == 0);
    CHECK_NEAR(rpy[1], pitch, 1e-12);
    CHECK(Pose::from_rpy({}, rpy).is_close(pose, 0, 1e-12));
  }
}

void test_refusals() {
  CHECK_THROWS(std::invalid_argument, Pose({kNaN, 0, 0}));
  CHECK_THROWS(std::invalid_argument, Pose({0, 0, 0}, {0, 0, 0, 1.01}));
  CHECK_THROWS(std::invalid_argument, Pose({0, 0, 0}, {0, 0, 0, 0}));
  CHECK_THROWS(std::invalid_argument, Pose::from_rpy({}, {0, kNaN, 0}));
  CHECK_THROWS(std::invalid_argument, Pose::exp(std::array<double, 6>{0, 0, 0, 1e200, 0, 0}));
  CHECK_THROWS(std::invalid_argument, Pose::from_matrix(std::array<double, 16>{}));
  auto mirror = Pose().matrix();
  mirror[0] = -1;
  CHECK_THROWS(std::invalid_argument, Pose::from_matrix(mirror));
  CHECK_THROWS(std::invalid_argument, Pose().interpolate(Pose(), 1.5));
  CHECK_THROWS(std::invalid_argument, rcs::limit_step(Pose(), Pose(), -1, 0));
  CHECK_THROWS(std::invalid_argument, rcs::normalize_quaternion({0, 0, 0, 0}));
  CHECK(rcs::normalize_quaternion({0, 0, 1e300, 0})[2] == 1);
}

}  // namespace

int main() {
  std::mt19937 generator(1);
  for (int i = 0; i < 1000; ++i) {
    const Pose a = random_pose(generator);
    const Pose b = random_pose(generator);
    test_group_axioms(a, b, random_pose(generator));
    test_round_trips(a * b);
    test_round_trips(a);
    test_steps(a, b);
  }
  test_half_turns();
  test_gimbal_lock();
  test_refusals();
  CHECK(rcs::to_string(Pose({0.1, 0, -2})) == "Pose(translation=(0.1, 0, -2), quaternion=(0, 0, 0, 1))");
  return rcs::test::result();
}
