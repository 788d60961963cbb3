// Ruckig's plan of a trajectory: of all joints together, or of each by itself.
#pragma once

#include <algorithm>
#include <array>
#include <ruckig/ruckig.hpp>
#include <vector>

#include "rcs/trajectory.hpp"

namespace rcs {

// Rows of `dof` numbers in the memory. The plan follows from the last five and the numbers behind.
enum Row { kTarget, kLast, kStream, kPosition, kVelocity, kAcceleration, kAim, kEnd, kRows };
// After the rows: time since the plan's start; its least duration, or below 0 where it is to brake and no more; and the
// share by which the acceleration is less than its limit; whether each joint goes by itself (1), or all wait for each
// other (0); then the order to hold.
enum Number { kElapsed, kLeast, kSpared, kApart, kHold, kNumbers };
static_assert(Trajectory::size(1) == int{kRows} + int{kNumbers});

// As libfranka, which stays that much below the limits that its robot checks (rate_limiting.h, kLimitEps).
inline constexpr double kMargin = 1e-3;
// In place of a least duration: all joints brake together, or each alone.
inline constexpr double kTogether = -1.0, kAlone = -2.0;
// By how much a plan may last longer than it must.
inline constexpr double kDetour = 1.01;

// A planned trajectory, and what it was planned for. Another memory, or a restored one, makes it plan anew.
struct Trajectory::Plan {
  explicit Plan(std::size_t dof) : ruckig(dof), input(dof), trajectory(dof), each(dof) {
    for (auto* values : {&position, &velocity, &acceleration, &target, &end, &later, &room, &aim, &speed})
      values->assign(dof, 0.0);
    for (auto& values : from) values.assign(dof, 0.0);
  }

  bool compute() { return is_planned(ruckig.calculate(input, trajectory)); }
  // The plan of one joint by itself.
  bool compute(std::size_t i) {
    one.current_position[0] = input.current_position[i];
    one.current_velocity[0] = input.current_velocity[i];
    one.current_acceleration[0] = input.current_acceleration[i];
    one.target_position[0] = input.target_position[i];
    one.target_velocity[0] = input.target_velocity[i];
    one.max_velocity[0] = input.max_velocity[i];
    one.max_acceleration[0] = input.max_acceleration[i];
    one.max_jerk[0] = input.max_jerk[i];
    return is_planned(single.calculate(one, each[i]));
  }
  static bool is_planned(ruckig::Result result) {
    return result == ruckig::Result::Working || result == ruckig::Result::Finished;
  }
  double duration() const {
    if (is_still) return 0.0;
    if (!is_apart) return trajectory.get_duration();
    double longest = 0.0;
    for (const auto& joint : each) longest = std::max(longest, joint.get_duration());
    return longest;
  }
  double soonest(std::size_t i) const { return each[i].get_independent_min_durations()[0]; }
  void at(double time) {
    if (is_still) {
      position = input.current_position;
      std::ranges::fill(velocity, 0.0);
      std::ranges::fill(acceleration, 0.0);
    } else if (is_apart) {
      for (std::size_t i = 0; i < each.size(); ++i) each[i].at_time(time, position[i], velocity[i], acceleration[i]);
    } else {
      trajectory.at_time(time, position, velocity, acceleration);
    }
  }

  ruckig::Ruckig<ruckig::DynamicDOFs> ruckig;
  ruckig::InputParameter<ruckig::DynamicDOFs> input;
  ruckig::Trajectory<ruckig::DynamicDOFs> trajectory;
  ruckig::Ruckig<1> single;
  ruckig::InputParameter<1> one;
  std::vector<ruckig::Trajectory<1>> each;
  std::vector<double> source;  // the numbers that it was computed from
  std::vector<double> source_before;
  bool is_still = true;   // it starts where it ends
  bool is_apart = false;  // each joint goes by itself
  std::vector<double> position, velocity, acceleration;
  // The inputs of the law: the targets, at which velocity they move, how much later the plan is to meet them [s], and
  // how far the range goes on behind them; where the arm is.
  std::vector<double> target, end, later, room;
  std::array<std::vector<double>, 3> from;
  std::vector<double> aim, speed;  // what it comes to: where to, at which velocity
};

}  // namespace rcs
