// Laws of kinematics: the Jacobian is the derivative of the pose, inverse and forward undo each other, answers stay
// inside the limits, and nothing is ever not finite.
#include <algorithm>
#include <array>
#include <atomic>
#include <cmath>
#include <random>
#include <thread>
#include <vector>

#include "check.hpp"
#include "model.hpp"
#include "rcs/kinematics.hpp"

namespace {

using rcs::DampedLeastSquares;
using rcs::IkOptions;
using rcs::IkResult;
using rcs::IkStatus;
using rcs::Pose;

constexpr int kDof = 6;

DampedLeastSquares make_solver() {
  const rcs::test::Model model = rcs::test::make_model(rcs::test::kArm);
  std::vector<int> joints;
  for (int i = 0; i < kDof; ++i) joints.push_back(i);
  return {model.get(), joints, 0, 1};
}

std::vector<double> random_joints(const DampedLeastSquares& solver, std::mt19937& generator) {
  std::vector<double> joints;
  for (int i = 0; i < kDof; ++i)
    joints.push_back(
        std::uniform_real_distribution<double>(solver.joint_lower()[i], solver.joint_upper()[i])(generator));
  return joints;
}

bool is_inside(const DampedLeastSquares& solver, const std::vector<double>& joints) {
  for (int i = 0; i < kDof; ++i)
    if (!(joints[i] >= solver.joint_lower()[i] && joints[i] <= solver.joint_upper()[i])) return false;
  return true;
}

void the_jacobian_is_the_derivative_of_the_pose() {
  DampedLeastSquares solver = make_solver();
  std::mt19937 generator(1);
  constexpr double step = 1e-6;
  for (int round = 0; round < 20; ++round) {
    const std::vector<double> joints = random_joints(solver, generator);
    const std::vector<double> jacobian = solver.jacobian(joints);
    for (int c = 0; c < kDof; ++c) {
      std::vector<double> more = joints, less = joints;
      more[c] += step;
      less[c] -= step;
      const Pose after = solver.forward(more), before = solver.forward(less);
      const auto turn = (after * before.inverse()).rotvec();
      for (int r = 0; r < 3; ++r) {
        CHECK_NEAR(jacobian[r * kDof + c], (after.translation()[r] - before.translation()[r]) / (2 * step), 1e-6);
        CHECK_NEAR(jacobian[(r + 3) * kDof + c], turn[r] / (2 * step), 1e-6);
      }
    }
  }
}

void inverse_undoes_forward() {
  DampedLeastSquares solver = make_solver();
  std::mt19937 generator(2);
  const std::vector<double> start(kDof, 0.3);
  int solved = 0;
  for (int round = 0; round < 100; ++round) {
    const Pose target = solver.forward(random_joints(solver, generator));
    const IkResult result = solver.inverse(target, start, IkOptions{});
    CHECK(is_inside(solver, result.joints));
    if (result.status != IkStatus::ok) continue;
    ++solved;
    const Pose reached = solver.forward(result.joints);
    CHECK(reached.distance_to(target) <= 1e-4);
    CHECK(reached.angle_to(target) <= 2e-4);
  }
  CHECK(solved >= 97);
}

void a_solution_too_far_away_is_clamped() {
  DampedLeastSquares solver = make_solver();
  const std::vector<double> start(kDof, 0.3);
  std::vector<double> there = start;
  there[0] = 1.0;
  IkOptions options;
  options.max_step.assign(kDof, 0.05);
  const IkResult result = solver.inverse(solver.forward(there), start, options);
  CHECK(result.status == IkStatus::clamped);
  double largest = 0.0;
  for (int i = 0; i < kDof; ++i) largest = std::max(largest, std::abs(result.joints[i] - start[i]));
  CHECK_NEAR(largest, 0.05, 1e-12);
}

void a_pose_out_of_reach_gives_the_start() {
  DampedLeastSquares solver = make_solver();
  const std::vector<double> start(kDof, 0.3);
  for (const double x : {2.0, 1e9, 1e154, 1e300}) {
    const IkResult result = solver.inverse(Pose({x, 0.0, 0.0}), start, IkOptions{});
    CHECK(result.status == IkStatus::infeasible);
    CHECK(result.joints == start);
  }
}

void with_best_effort_a_pose_out_of_reach_gives_the_nearest() {
  DampedLeastSquares solver = make_solver();
  std::mt19937 generator(5);
  const std::vector<double> start(kDof, 0.3);
  IkOptions options;
  options.best_effort = true;
  options.iterations = 200;
  for (int round = 0; round < 20; ++round) {
    const auto near = solver.forward(random_joints(solver, generator)).translation();
    const Pose target({3 * near[0], 3 * near[1], 3 * near[2]}, solver.forward(start).quaternion());
    const double before = solver.forward(start).distance_to(target);
    const IkResult result = solver.inverse(target, start, options);
    CHECK(is_inside(solver, result.joints));
    CHECK(result.status == IkStatus::nearest || result.status == IkStatus::ok);
    CHECK(solver.forward(result.joints).distance_to(target) < before);
    CHECK_NEAR(solver.forward(result.joints).distance_to(target), result.translation_error, 1e-9);
  }
}

void with_best_effort_no_joint_moves_farther_than_it_may() {
  DampedLeastSquares solver = make_solver();
  std::mt19937 generator(6);
  const std::vector<double> start(kDof, 0.3);
  IkOptions options;
  options.best_effort = true;
  for (int i = 0; i < kDof; ++i) options.max_step.push_back(0.02 * (i + 1));
  int clamped = 0;
  for (int round = 0; round < 50; ++round) {
    const IkResult result = solver.inverse(solver.forward(random_joints(solver, generator)), start, options);
    clamped += result.status == IkStatus::clamped ? 1 : 0;
    for (int i = 0; i < kDof; ++i) CHECK(std::abs(result.joints[i] - start[i]) <= options.max_step[i] + 1e-12);
  }
  CHECK(clamped > 25);
}

void a_batch_is_a_loop_at_any_number_of_threads() {
  DampedLeastSquares solver = make_solver();
  std::mt19937 generator(3);
  constexpr std::size_t count = 30;
  std::vector<double> targets, starts(count * kDof, 0.3);
  for (std::size_t i = 0; i < count; ++i) {
    const Pose pose = solver.forward(random_joints(solver, generator));
    targets.insert(targets.end(), pose.translation().begin(), pose.translation().end());
    targets.insert(targets.end(), pose.quaternion().begin(), pose.quaternion().end());
  }
  std::vector<std::vector<double>> answers;
  for (const int threads : {1, 2, 4, 64}) {
    std::vector<double> joints(count * kDof);
    std::vector<std::uint8_t> status(count);
    std::vector<double> errors(2 * count);
    solver.inverse_batch(targets, starts, IkOptions{}, threads, joints, status, errors);
    answers.push_back(joints);
    CHECK(answers.back() == answers.front());
  }
}

void velocities_move_the_tcp_at_the_twist_and_advancing_follows_it() {
  DampedLeastSquares solver = make_solver();
  std::mt19937 generator(9);
  rcs::VelocityOptions options;
  options.max_velocity.assign(kDof, 2.0);
  const std::array<double, 6> twist = {0.02, -0.03, 0.01, 0.1, 0.0, -0.1};
  int met = 0;
  for (int round = 0; round < 50; ++round) {
    const std::vector<double> start = random_joints(solver, generator);
    const rcs::Velocities found = solver.velocities(start, twist, options);
    const std::vector<double> jacobian = solver.jacobian(start);
    for (const double v : found.joints) CHECK(std::abs(v) <= 2.0 + 1e-12);
    const IkResult later = solver.advance(start, twist, 0.1, options);
    CHECK(is_inside(solver, later.joints));
    for (int i = 0; i < kDof; ++i) CHECK(std::abs(later.joints[i] - start[i]) <= 0.2 + 1e-12);
    if (found.status == IkStatus::ok)
      for (int r = 0; r < 6; ++r) {
        double moved = 0.0;
        for (int c = 0; c < kDof; ++c) moved += jacobian[r * kDof + c] * found.joints[c];
        CHECK_NEAR(moved, twist[r], 1e-4);
      }
    if (later.status != IkStatus::ok) continue;
    ++met;
    const auto &before = solver.forward(start).translation(), &after = solver.forward(later.joints).translation();
    for (int r = 0; r < 3; ++r) CHECK_NEAR(after[r] - before[r], 0.1 * twist[r], 1e-5);
  }
  CHECK(met > 10);
}

void one_solver_serves_many_threads() {
  DampedLeastSquares solver = make_solver();
  std::mt19937 generator(4);
  constexpr std::size_t count = 40;
  const std::vector<double> start(kDof, 0.3);
  std::vector<Pose> targets;
  std::vector<std::vector<double>> expected;
  for (std::size_t i = 0; i < count; ++i) {
    targets.push_back(solver.forward(random_joints(solver, generator)));
    expected.push_back(solver.inverse(targets[i], start, IkOptions{}).joints);
  }
  std::atomic<int> wrong = 0;
  {
    std::vector<std::jthread> threads;
    for (std::size_t t = 0; t < 4; ++t)
      threads.emplace_back([&, t] {
        for (std::size_t k = 0; k < count; ++k) {
          const std::size_t i = (k + t * count / 4) % count;
          const std::vector<double> joints = solver.inverse(targets[i], start, IkOptions{}).joints;
          if (joints != expected[i]) ++wrong;
          if (solver.forward(expected[i]).distance_to(solver.forward(joints)) > 0.0) ++wrong;
          if (solver.jacobian(joints) != solver.jacobian(expected[i])) ++wrong;
        }
      });
  }
  CHECK(wrong == 0);
}

void what_makes_no_sense_is_refused() {
  DampedLeastSquares solver = make_solver();
  const std::vector<double> short_joints(kDof - 1, 0.0), nan_joints(kDof, std::nan(""));
  CHECK_THROWS(rcs::InvalidSetup, solver.forward(short_joints));
  CHECK_THROWS(rcs::InvalidSetup, solver.jacobian(nan_joints));
  CHECK_THROWS(rcs::InvalidSetup, solver.inverse(Pose(), short_joints, IkOptions{}));
  const rcs::test::Model model = rcs::test::make_model(rcs::test::kArm);
  CHECK_THROWS(rcs::InvalidSetup, DampedLeastSquares(model.get(), {}, 0, 1));
  CHECK_THROWS(rcs::InvalidSetup, DampedLeastSquares(model.get(), {0, 99}, 0, 1));
  CHECK_THROWS(rcs::InvalidSetup, DampedLeastSquares(model.get(), {0}, 1, 1));
}

}  // namespace

int main() {
  the_jacobian_is_the_derivative_of_the_pose();
  inverse_undoes_forward();
  a_solution_too_far_away_is_clamped();
  a_pose_out_of_reach_gives_the_start();
  with_best_effort_a_pose_out_of_reach_gives_the_nearest();
  with_best_effort_no_joint_moves_farther_than_it_may();
  a_batch_is_a_loop_at_any_number_of_threads();
  velocities_move_the_tcp_at_the_twist_and_advancing_follows_it();
  one_solver_serves_many_threads();
  what_makes_no_sense_is_refused();
  return rcs::test::result();
}
