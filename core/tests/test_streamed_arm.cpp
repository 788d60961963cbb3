// Arms that a thread leads from command to command: their points, within limits, box and time to live.
#include <algorithm>
#include <cmath>
#include <random>
#include <thread>
#include <vector>

#include "rcs/trajectory.hpp"
#include "servo.hpp"

namespace {

using namespace rcs::test;
using namespace std::chrono_literals;

void nothing_starts_before_the_first_command_and_that_must_be_near() {
  Servo arm(on_a_hand_clock());
  arm.open();
  arm.advance(10);
  CHECK(arm.starts == 0 && arm.points.empty());
  const std::string refusal = message_of([&] { arm.command_joints(Values{0.1, 0.9, -0.5}); });
  CHECK(has(refusal, "joint 1 is at -0.2 rad") && has(refusal, "1.1 rad away") && has(refusal, "at most 0.2"));
  arm.advance(10);
  CHECK(arm.starts == 0 && arm.points.empty() && arm.fault().empty());
  arm.command_joints(Values{0.1, -0.1, -0.5});
  arm.advance(1);
  CHECK(arm.starts == 1 && arm.points.size() == 1);
  CHECK_NEAR(arm.points[0].position[1], -0.2, 1e-4);
  arm.advance(200);
  arm.command_joints(Values{0.9, -0.1, -0.5});  // it is led by now, and may be far
  arm.advance(2000);
  CHECK(arm.starts == 1 && arm.has_arrived());
  CHECK_NEAR(arm.state().joints[0], 0.9, 1e-9);
  arm.run_freely();
  arm.close();
  CHECK(arm.stops == 1);
  check_within_limits(arm.points);
}

void the_points_are_those_of_the_law_of_simulated_arms() {
  const rcs::ArmLimits most = figures();
  rcs::Trajectory law(
      {most.joint_lower, most.joint_upper, most.joint_velocity, most.joint_acceleration, most.joint_jerk});
  Values memory(static_cast<std::size_t>(rcs::Trajectory::size(3)));
  for (const double lag : {0.0, 0.05}) {
    Servo arm(on_a_hand_clock(), lag);
    rcs::Trajectory::stand(memory, arm.joints);
    Values target = arm.joints;
    arm.open();
    std::mt19937 random(3);
    std::normal_distribution<double> step(0.0, 0.04);
    double apart = 0.0;
    for (int k = 0; k < 200; ++k) {
      for (std::size_t i = 0; i < 3; ++i)
        target[i] = std::clamp(target[i] + step(random), most.joint_lower[i], most.joint_upper[i]);
      arm.command_joints(target);
      arm.advance(kTicks);
      std::ranges::copy(target, memory.begin());
      if (law.is_asked(memory.data())) law.follow(memory.data(), {kPeriod, kPeriod, 0.0, false}, 1.0);
      for (int tick = 0; tick < kTicks; ++tick) {
        law.advance(memory.data(), 1.0 / kRate);
        const auto& point = arm.points[static_cast<std::size_t>(k * kTicks + tick)];
        for (std::size_t i = 0; i < 3; ++i) {
          apart = std::max(apart, std::abs(point.position[i] - law.position()[i]));
          apart = std::max(apart, std::abs(point.velocity[i] - law.velocity()[i]));
        }
      }
    }
    CHECK(apart == 0.0);
    CHECK(arm.points.size() == 200u * kTicks);
    arm.run_freely();
    arm.close();
  }
}

void violent_commands_stay_within_all_limits() {
  const rcs::ArmLimits most = figures();
  Servo arm(on_a_hand_clock());
  arm.open();
  arm.command_joints(arm.joints);
  std::mt19937 random(1);
  std::uniform_real_distribution<double> share(0.0, 1.0);
  Values target = arm.joints;
  Worst worst;
  for (int k = 0; k < 10000; ++k) {
    const double kind = share(random);
    for (std::size_t i = 0; i < 3; ++i) {
      const double lower = most.joint_lower[i], upper = most.joint_upper[i];
      if (kind < 0.4) target[i] = lower + share(random) * (upper - lower);
      if (kind >= 0.4 && kind < 0.9) target[i] = std::clamp(target[i] + 0.2 * (share(random) - 0.5), lower, upper);
      if (kind >= 0.97) target[i] = share(random) < 0.5 ? lower : upper;
    }
    if (kind < 0.95)
      arm.command_joints(target);
    else if (kind < 0.97)
      arm.hold();
    arm.advance(1 + static_cast<int>(60 * share(random)));  // too early and too late, too
  }
  check_within_limits(arm.points);
  CHECK(arm.clamped().speed > 1000 && arm.clamped().acceleration > 1000 && arm.clamped().range == 0);
}

void clamped_commands_are_counted_by_what_was_too_much() {
  rcs::StreamOptions options = on_a_hand_clock();
  options.margin = 0.05;
  Servo arm(options);
  arm.open();
  Values target = arm.joints;
  arm.command_joints(target);
  arm.advance(kTicks);
  for (int k = 0; k < 10; ++k) {  // gently
    target[0] += 1e-5 * k * k;
    arm.command_joints(target);
    arm.advance(kTicks);
  }
  rcs::Clamped count = arm.clamped();
  CHECK(count.range + count.speed + count.acceleration + count.jerk + count.box == 0);
  arm.command_joints(Values{2.0, target[1], target[2]});
  count = arm.clamped();
  arm.advance(3000);
  count = arm.clamped();
  CHECK(count.range == 1 && count.speed == 1 && count.acceleration == 1 && count.jerk == 1);
  CHECK_NEAR(arm.state().joints[0], 1.95, 1e-9);
}

void a_command_whose_time_is_over_brakes_the_arm() {
  Servo arm(on_a_hand_clock());
  arm.open();
  arm.command_joints(arm.joints);
  arm.advance(kTicks);
  arm.command_joints(Values{1.5, -0.2, -0.5}, 0.1);
  arm.advance(200);  // of its own clock: the time of the host counts
  if (arm.lapses() == 0) CHECK(arm.points.back().velocity[0] > 0.5);
  std::this_thread::sleep_for(110ms);
  arm.advance(1000);
  CHECK(arm.lapses() == 1);
  CHECK(is_still(arm.points.back()) && arm.state().joints[0] < 1.4);
  CHECK(arm.fault().empty() && arm.has_arrived());
  arm.command_joints(Values{0.0, -0.2, -0.5});
  arm.advance(3000);
  CHECK_NEAR(arm.state().joints[0], 0.0, 1e-9);
  check_within_limits(arm.points);
}

void the_tcp_stays_in_its_box() {
  rcs::StreamOptions options = on_a_hand_clock();
  // The TCP is at the end of two links of 0.5 m, as joints 0 and 1 say.
  const auto tcp = [](std::span<const double> q) {
    return std::array{0.5 * std::cos(q[0]) + 0.5 * std::cos(q[0] + q[1]),
                      0.5 * std::sin(q[0]) + 0.5 * std::sin(q[0] + q[1]), q[2]};
  };
  options.box = rcs::TcpBox{{-1.0, -0.4, -4.0}, {1.0, 0.4, 1.0}, tcp};
  Servo arm(options);
  arm.open();
  arm.command_joints(arm.joints);
  arm.advance(kTicks);
  std::mt19937 random(2);
  std::uniform_real_distribution<double> share(0.0, 1.0);
  const rcs::ArmLimits most = figures();
  for (int k = 0; k < 300; ++k) {
    Values target(3);
    for (std::size_t i = 0; i < 3; ++i)
      target[i] = most.joint_lower[i] + share(random) * (most.joint_upper[i] - most.joint_lower[i]);
    arm.command_joints(target);
    arm.advance(10 * kTicks);
  }
  double farthest = 0.0;
  for (const auto& point : arm.points) farthest = std::max(farthest, std::abs(tcp(point.position)[1]));
  CHECK(farthest <= 0.4 + 1e-3);
  CHECK(farthest > 0.38);
  CHECK(arm.clamped().box > 50 && arm.clamped().box <= 300);
  check_within_limits(arm.points);
}

void an_arm_that_is_found_outside_of_its_range_comes_back_slowly() {
  Servo arm(on_a_hand_clock());
  arm.joints[0] = 2.05;
  arm.open();
  arm.command_joints(Values{2.0, -0.2, -0.5});
  arm.advance(3000);
  CHECK_NEAR(arm.state().joints[0], 2.0, 1e-3);
  const auto is_inside = [](const auto& point) { return point.position[0] <= 2.0; };
  arm.points.reserve(10000);
  const auto inside = std::ranges::find_if(arm.points, is_inside);
  CHECK(inside - arm.points.begin() > 300);
  CHECK(std::all_of(inside, arm.points.end(), is_inside));
  for (auto point = arm.points.begin(); point != inside; ++point)
    CHECK(point->velocity[0] <= 0.0 && point->velocity[0] > -0.16);
  // Once it is back, its range ends where it should: what passes a target does not pass the end.
  for (double target = 1.0; target < 2.0; target += 0.05) {
    arm.command_joints(Values{target, -0.2, -0.5});
    arm.advance(kTicks);
  }
  arm.command_joints(Values{2.0, -0.2, -0.5});
  arm.advance(1000);
  CHECK(std::all_of(inside, arm.points.end(), is_inside));
}

void an_arm_that_is_found_in_the_margin_may_stay_there() {
  rcs::StreamOptions options = on_a_hand_clock();
  options.margin = 0.1;
  Servo arm(options);
  arm.joints[0] = 1.95;
  arm.open();
  for (const double target : {1.95, 1.98, 1.95}) {
    arm.command_joints(Values{target, -0.2, -0.5});
    arm.advance(500);
    CHECK_NEAR(arm.state().joints[0], 1.95, 0.0);
  }
  CHECK(arm.clamped().range == 1);
  arm.command_joints(Values{1.8, -0.2, -0.5});
  arm.advance(3000);
  arm.command_joints(Values{1.95, -0.2, -0.5});
  arm.advance(3000);
  CHECK_NEAR(arm.state().joints[0], 1.9, 1e-9);
}

void a_person_guides_the_arm_until_it_is_held() {
  Servo arm(on_its_own_clock());
  arm.open();
  arm.command_joints(arm.state().joints);
  await([&] { return arm.ticks() > 2; });
  arm.guide(true);
  const std::uint64_t before = arm.ticks();
  arm.move_by_hand(0, 0.7);
  std::this_thread::sleep_for(10ms);
  CHECK(arm.ticks() == before);
  arm.hold();
  await([&] { return arm.ticks() > before; });
  arm.command_joints(Values{0.7, -0.2, -0.5});
  arm.close();
  CHECK_NEAR(arm.points.back().position[0], 0.7, 0.0);
}

void what_came_right_before_guiding_ends_with_it() {
  rcs::StreamOptions options = on_its_own_clock();
  options.rate = 10.0;
  options.period = 0.1;
  for (const auto& before : {+[](Servo& arm) { arm.hold(); }, +[](Servo& arm) { arm.recover(); },
                             +[](Servo& arm) { arm.command_joints(Values(arm.joints)); }}) {
    Servo arm(options);
    arm.open();
    std::this_thread::sleep_for(30ms);  // between two ticks
    before(arm);
    arm.guide(true);
    std::this_thread::sleep_for(300ms);
    CHECK(arm.is_guided() && arm.starts == 0 && arm.points.empty());
    arm.close();
  }
}

void arms_of_one_rate_tick_at_the_same_moments() {
  rcs::StreamOptions options = on_its_own_clock();
  options.rate = 100.0;
  for (const auto delay : {0ms, 3ms, 7ms}) {
    std::this_thread::sleep_for(delay);
    Servo arm(options);
    arm.open();
    arm.command_joints(Values(arm.joints));
    Values phases;
    for (double before = arm.state().time; phases.size() < 31;) {
      await([&] { return arm.state().time != before; });
      before = arm.state().time;
      const double ticks = before * options.rate;
      phases.push_back(ticks - std::round(ticks));
    }
    std::ranges::nth_element(phases, phases.begin() + 15);
    CHECK(std::abs(phases[15]) < 0.1);  // most wake within a millisecond
    arm.close();
  }
}

}  // namespace

int main() {
  nothing_starts_before_the_first_command_and_that_must_be_near();
  the_points_are_those_of_the_law_of_simulated_arms();
  violent_commands_stay_within_all_limits();
  clamped_commands_are_counted_by_what_was_too_much();
  a_command_whose_time_is_over_brakes_the_arm();
  the_tcp_stays_in_its_box();
  an_arm_that_is_found_outside_of_its_range_comes_back_slowly();
  an_arm_that_is_found_in_the_margin_may_stay_there();
  a_person_guides_the_arm_until_it_is_held();
  what_came_right_before_guiding_ends_with_it();
  arms_of_one_rate_tick_at_the_same_moments();
  return rcs::test::result();
}
