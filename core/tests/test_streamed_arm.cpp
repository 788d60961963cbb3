// Arms that a thread leads from command to command: against a servo that takes its points, mostly on a clock that the
// test moves.
#include <algorithm>
#include <chrono>
#include <cmath>
#include <condition_variable>
#include <mutex>
#include <random>
#include <stdexcept>
#include <string>
#include <thread>
#include <vector>

#include "check.hpp"
#include "rcs/result.hpp"
#include "rcs/streamed_arm.hpp"
#include "rcs/trajectory.hpp"

namespace {

using namespace std::chrono_literals;
using Values = std::vector<double>;

constexpr double kRate = 1000.0, kPeriod = 1.0 / 25.0;
constexpr int kTicks = 40;  // per period

rcs::ArmLimits figures() {
  return {{-2.0, -1.5, -3.0}, {2.0, 1.0, 0.5}, {2.0, 1.5, 3.0}, {10.0, 8.0, 12.0}, {500.0, 1000.0, 5000.0}, {}};
}

rcs::StreamOptions on_a_hand_clock() {
  rcs::StreamOptions options;
  options.rate = kRate;
  options.period = kPeriod;
  options.is_paced_by_read = true;
  options.silence = 100.0;
  options.tracking_error = 10.0;
  return options;
}

/// Three joints that are where the points say, or follow them with a lag.
class Servo final : public rcs::StreamedArm {
 public:
  explicit Servo(rcs::StreamOptions options, double lag = 0.0)
      : StreamedArm("servo", figures(), options), share_(lag > 0.0 ? 1.0 - std::exp(-1.0 / (kRate * lag)) : 1.0) {}
  ~Servo() override {
    run_freely();
    close();
  }

  /// Let so many ticks pass, and return when the last one is done.
  void advance(int ticks) {
    std::unique_lock lock(mutex_);
    granted_ = ticks;
    changed_.notify_all();
    changed_.wait(lock, [&] { return granted_ == 0 && is_waiting_; });
  }
  void run_freely() {
    const std::lock_guard lock(mutex_);
    is_free_ = true;
    changed_.notify_all();
  }

  void move_by_hand(std::size_t joint, double position) {
    const std::lock_guard lock(mutex_);
    joints[joint] = position;
  }

  Values joints{0.1, -0.2, -0.5};
  std::vector<rcs::StreamPoint> points;
  std::atomic<int> starts = 0, stops = 0, clears = 0;
  std::atomic<bool> is_lost = false, refuses = false, is_blocked = false, sleeps = false, fails_to_stop = false;
  std::atomic<bool> has_stopped_elsewhere = false;
  bool can_guide() const override { return true; }

 protected:
  void connect() override { is_first_ = true; }
  void read(rcs::ArmState& state) override {
    if (options().is_paced_by_read && !is_first_) {
      std::unique_lock lock(mutex_);
      is_waiting_ = true;
      changed_.notify_all();
      changed_.wait(lock, [&] { return granted_ > 0 || is_free_; });
      is_waiting_ = false;
      if (granted_ > 0) --granted_;
    }
    if (!is_first_) reader_ = std::this_thread::get_id();
    is_first_ = false;
    while (sleeps) std::this_thread::sleep_for(1ms);
    if (is_lost) throw std::runtime_error("no answer from the controller");
    const std::lock_guard lock(mutex_);
    state.joints = joints;
    state.joint_velocities.assign(3, 0.0);
  }
  void start() override {
    is_first_ = true;  // what it reads next is no tick
    ++starts;
  }
  void write(const rcs::StreamPoint& point) override {
    if (refuses) throw std::runtime_error("the controller is in its mode reflex");
    points.push_back(point);
    const std::lock_guard lock(mutex_);
    for (std::size_t i = 0; i < 3 && !is_blocked; ++i) joints[i] += share_ * (point.position[i] - joints[i]);
  }
  void stop() override {
    ++stops;
    if (std::this_thread::get_id() != reader_) has_stopped_elsewhere = true;
    if (fails_to_stop) throw std::runtime_error("it does not stop");
  }
  void clear() override {
    ++clears;
    is_first_ = true;
    refuses = false;
  }
  void give_way() override {}

 private:
  const double share_;
  std::mutex mutex_;
  std::condition_variable changed_;
  int granted_ = 0;
  bool is_free_ = false, is_waiting_ = false;
  std::atomic<bool> is_first_ = true;
  std::atomic<std::thread::id> reader_;
};

/// The largest of |value| / limit.
struct Worst {
  double speed = 0.0, acceleration = 0.0, jerk = 0.0;
  int outside = 0;
};

Worst worst_of(const std::vector<rcs::StreamPoint>& points, double rate) {
  Worst worst;
  const rcs::ArmLimits most = figures();
  for (std::size_t i = 0; i < 3; ++i)
    for (std::size_t k = 1; k < points.size(); ++k) {
      const auto &before = points[k - 1], &now = points[k];
      const double x = now.position[i];
      worst.outside += x < most.joint_lower[i] || x > most.joint_upper[i];
      const auto ratio = [&](double from, double to, const Values& limit) {
        return std::abs(to - from) * rate / limit[i];
      };
      worst.speed = std::max(worst.speed, ratio(before.position[i], x, most.joint_velocity));
      worst.jerk = std::max(worst.jerk, ratio(before.acceleration[i], now.acceleration[i], most.joint_jerk));
      if (k < 2) continue;
      const double first = x - before.position[i], second = before.position[i] - points[k - 2].position[i];
      worst.acceleration = std::max(worst.acceleration, ratio(second * rate, first * rate, most.joint_acceleration));
    }
  return worst;
}

void check_within_limits(const std::vector<rcs::StreamPoint>& points) {
  const Worst worst = worst_of(points, kRate);
  CHECK(worst.speed <= 1.01);
  CHECK(worst.acceleration <= 1.01);
  CHECK(worst.jerk <= 1.01);
  CHECK(worst.outside == 0);
  if (worst.speed > 1.01 || worst.acceleration > 1.01 || worst.jerk > 1.01)
    std::fprintf(stderr, "  %.4f %.4f %.4f of the limits\n", worst.speed, worst.acceleration, worst.jerk);
}

bool is_still(const rcs::StreamPoint& point) {
  return std::ranges::all_of(point.velocity, [](double v) { return v == 0.0; });
}

std::string message_of(auto call) {
  try {
    call();
  } catch (const std::exception& error) {
    return error.what();
  }
  return "";
}

bool has(const std::string& text, const char* part) { return text.find(part) != std::string::npos; }

template <typename Condition>
void await(Condition condition) {
  for (int k = 0; k < 5000 && !condition(); ++k) std::this_thread::sleep_for(1ms);
  CHECK(condition());
}

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

void another_thread_holds_and_faults_brake_within_the_limits() {
  Servo arm(on_a_hand_clock());
  arm.open();
  arm.command_joints(arm.joints);
  arm.advance(kTicks);
  arm.command_joints(Values{1.5, 0.5, -2.5});
  arm.advance(150);
  std::thread([&] { arm.hold(); }).join();
  CHECK(!arm.has_arrived());
  arm.advance(600);
  CHECK(arm.has_arrived() && arm.state().joints[0] < 1.0 && arm.stops == 0);
  arm.command_joints(Values{1.5, 0.5, -2.5});
  arm.advance(150);
  std::thread([&] { rcs::stop_all("a person came near"); }).join();
  arm.advance(600);
  CHECK(is_still(arm.points.back()) && arm.stops == 0);
  CHECK_THROWS(rcs::DeviceFault, arm.command_joints(arm.joints));
  arm.run_freely();
  arm.recover();
  arm.command_joints(Values{0.1, -0.2, -0.5});
  std::this_thread::sleep_for(5ms);
  rcs::stop_all("the program ends");
  CHECK(arm.has_arrived());  // it has come to rest: there may be no more ticks
  arm.recover();
  CHECK(arm.clears == 0);  // the controller was well
  arm.command_joints(arm.state().joints);
  arm.close();
  check_within_limits(arm.points);
}

void what_the_vendor_throws_is_the_fault_in_its_words() {
  for (const bool is_write : {false, true}) {
    Servo arm(on_a_hand_clock());
    arm.open();
    arm.command_joints(Values{0.2, -0.2, -0.5});
    arm.advance(20);
    (is_write ? arm.refuses : arm.is_lost) = true;
    arm.fails_to_stop = true;
    arm.run_freely();
    await([&] { return !arm.fault().empty(); });
    const char* reason =
        is_write ? "write failed: the controller is in its mode reflex" : "read failed: no answer from the controller";
    CHECK(arm.fault().starts_with(reason) && arm.fault().ends_with("; stop failed: it does not stop"));
    CHECK(arm.stops == 1);
    if (is_write)
      CHECK(arm.state().joints == arm.joints);
    else {
      CHECK_THROWS(rcs::DeviceFault, arm.state());
      CHECK_THROWS(rcs::DeviceFault, arm.hold());  // nobody may believe that it was told
    }
    CHECK_THROWS(rcs::DeviceFault, arm.command_joints(arm.joints));
    const std::size_t before = arm.points.size();
    if (!is_write) {
      CHECK(has(message_of([&] { arm.recover(); }), "recover failed: no answer from the controller"));
      CHECK(arm.fault().starts_with(reason));
    }
    arm.is_lost = false;
    arm.recover();
    CHECK(arm.clears == (is_write ? 1 : 2) && arm.fault().empty() && arm.points.size() == before);
    arm.move_by_hand(0, 0.7);
    std::this_thread::sleep_for(5ms);
    const Values here = arm.state().joints;
    CHECK_NEAR(here[0], 0.7, 0.0);
    arm.command_joints(here);
    await([&] { return arm.starts == 2; });
    arm.fails_to_stop = false;
    arm.close();
    CHECK_NEAR(arm.points[before].position[0], here[0], 0.0);
  }
}

void a_joint_that_does_not_follow_is_a_fault_by_its_number() {
  rcs::StreamOptions options = on_a_hand_clock();
  options.tracking_error = 0.1;
  Servo arm(options);
  arm.open();
  arm.command_joints(arm.joints);
  arm.advance(kTicks);
  arm.is_blocked = true;
  arm.command_joints(Values{0.1, 0.5, -0.5});
  arm.advance(1000);
  CHECK(arm.fault().starts_with("joint 1 is at -0.2 rad and was led to") && has(arm.fault(), "0.1 rad: it is blocked"));
  CHECK(arm.stops == 1 && arm.points.back().position[1] < -0.09);
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

void too_many_missed_ticks_are_a_fault() {
  rcs::StreamOptions options;
  options.silence = 100.0;
  options.missed_ticks = 100;
  Servo arm(options);
  arm.open();
  CHECK(arm.real_time_advice().empty() || has(arm.real_time_advice(), "/etc/security/limits.conf"));
  arm.sleeps = true;
  std::this_thread::sleep_for(200ms);
  arm.sleeps = false;
  await([&] { return arm.missed_ticks() > 100; });
  CHECK(arm.fault().empty());  // it was not led
  arm.command_joints(arm.state().joints);
  await([&] { return arm.ticks() > 2; });
  arm.sleeps = true;
  std::this_thread::sleep_for(200ms);
  arm.sleeps = false;
  await([&] { return !arm.fault().empty(); });
  CHECK(has(arm.fault(), "ticks too late: this machine is busy") && arm.stops == 1);
}

void a_call_that_does_not_return_is_a_fault_and_does_not_keep_the_arm_from_being_stopped() {
  for (const bool is_found_by_measuring : {false, true}) {
    rcs::StreamOptions options;
    options.missed_ticks = 10000;
    options.silence = 0.2;
    Servo arm(options);
    arm.open();
    arm.command_joints(arm.state().joints);
    await([&] { return arm.ticks() > 2; });
    arm.sleeps = true;
    std::this_thread::sleep_for(250ms);
    if (is_found_by_measuring)
      CHECK(has(message_of([&] { arm.state(); }), "has not answered for 0."));
    else
      arm.hold();
    CHECK(arm.stops == 1 && arm.has_stopped_elsewhere);
    CHECK_THROWS(rcs::DeviceFault, arm.command_joints(Values{0.1, -0.2, -0.5}));
    arm.sleeps = false;
    await([&] { return !arm.fault().empty(); });
    const std::size_t before = arm.points.size();
    std::this_thread::sleep_for(20ms);
    CHECK(arm.points.size() <= before + 1);
    arm.recover();
    CHECK(arm.clears == 1);
    arm.command_joints(arm.state().joints);
    await([&] { return arm.starts == 2; });
  }
}

void a_person_guides_the_arm_until_it_is_held() {
  rcs::StreamOptions options;
  options.missed_ticks = 10000;
  Servo arm(options);
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

void a_fault_ends_guiding_before_the_arm_recovers() {
  rcs::StreamOptions options;
  options.missed_ticks = 10000;
  Servo arm(options);
  arm.open();
  for (int k = 0; k < 200; ++k) {
    arm.guide(true);
    arm.set_fault("stop");
    arm.recover();
    CHECK(arm.clears == 0 && arm.fault().empty());  // it is led again, and so the controller is well
  }
  arm.close();
}

void options_that_make_no_sense_are_refused() {
  rcs::ArmLimits few = figures();
  few.joint_jerk.clear();
  struct Bare final : rcs::StreamedArm {
    using StreamedArm::StreamedArm;
    void read(rcs::ArmState&) override {}
    void write(const rcs::StreamPoint&) override {}
    void stop() override {}
  };
  CHECK(has(message_of([&] { Bare("bare", few); }), "bare: a streamed arm needs limits of acceleration and jerk"));
  const auto refusal = [](auto change) {
    rcs::StreamOptions options;
    change(options);
    return message_of([&] { Bare("bare", figures(), options); });
  };
  CHECK(has(refusal([](auto& o) { o.rate = 5.0; }), "10 to 2000 Hz"));
  CHECK(has(refusal([](auto& o) { o.period = std::nan(""); }), "one tick to 10 s"));
  CHECK(has(refusal([](auto& o) { o.margin = 1.3; }), "margin"));
  CHECK(has(refusal([](auto& o) { o.box = rcs::TcpBox{{0, 0, 0}, {1, 1, 1}, nullptr}; }), "gives the TCP"));
  Bare arm("bare", figures());
  CHECK_THROWS(rcs::InvalidSetup, arm.set_period(0.0));
  CHECK(arm.period() == 1.0 / 30.0);
}

}  // namespace

int main() {
  nothing_starts_before_the_first_command_and_that_must_be_near();
  the_points_are_those_of_the_law_of_simulated_arms();
  violent_commands_stay_within_all_limits();
  clamped_commands_are_counted_by_what_was_too_much();
  a_command_whose_time_is_over_brakes_the_arm();
  another_thread_holds_and_faults_brake_within_the_limits();
  what_the_vendor_throws_is_the_fault_in_its_words();
  a_joint_that_does_not_follow_is_a_fault_by_its_number();
  the_tcp_stays_in_its_box();
  an_arm_that_is_found_outside_of_its_range_comes_back_slowly();
  an_arm_that_is_found_in_the_margin_may_stay_there();
  too_many_missed_ticks_are_a_fault();
  a_call_that_does_not_return_is_a_fault_and_does_not_keep_the_arm_from_being_stopped();
  a_person_guides_the_arm_until_it_is_held();
  a_fault_ends_guiding_before_the_arm_recovers();
  options_that_make_no_sense_are_refused();
  return rcs::test::result();
}
