// A servo that takes the points of a streamed arm, mostly on a clock that the test moves.
#pragma once

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cmath>
#include <condition_variable>
#include <cstdio>
#include <mutex>
#include <stdexcept>
#include <string>
#include <thread>
#include <vector>

#include "check.hpp"
#include "rcs/result.hpp"
#include "rcs/streamed_arm.hpp"

namespace rcs::test {

using namespace std::chrono_literals;
using Values = std::vector<double>;

inline constexpr double kRate = 1000.0, kPeriod = 1.0 / 25.0;
inline constexpr int kTicks = 40;  // per period

inline rcs::ArmLimits figures() {
  return {{-2.0, -1.5, -3.0}, {2.0, 1.0, 0.5}, {2.0, 1.5, 3.0}, {10.0, 8.0, 12.0}, {500.0, 1000.0, 5000.0}, {}};
}

inline rcs::StreamOptions on_a_hand_clock() {
  rcs::StreamOptions options;
  options.rate = kRate;
  options.period = kPeriod;
  options.is_paced_by_read = true;
  options.silence = 100.0;
  options.tracking_error = 10.0;
  return options;
}

/// A busy machine is no fault.
inline rcs::StreamOptions on_its_own_clock() {
  rcs::StreamOptions options;
  options.missed_ticks = 10000;
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
  std::atomic<bool> hangs_in_stop = false, fails_to_start = false, loses_at_start = false, fails_to_give_way = false;
  std::atomic<int> losses = 0;  // reads that fail
  Values commanded;             // given as it is
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
    if (is_lost || (losses > 0 && losses-- > 0)) throw std::runtime_error("no answer from the controller");
    const std::lock_guard lock(mutex_);
    state.joints = joints;
    state.joint_velocities.assign(3, 0.0);
    state.commanded_joints = commanded;
  }
  void start() override {
    is_first_ = true;  // what it reads next is no tick
    ++starts;
    if (fails_to_start) throw std::runtime_error("it does not start");
    if (loses_at_start) is_lost = true;
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
    while (hangs_in_stop) std::this_thread::sleep_for(1ms);
    if (fails_to_stop) throw std::runtime_error("it does not stop");
  }
  void clear() override {
    ++clears;
    is_first_ = true;
    refuses = false;
  }
  void give_way() override {
    if (fails_to_give_way) throw std::runtime_error("a servo keeps its torque");
  }

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

inline Worst worst_of(const std::vector<rcs::StreamPoint>& points, double rate) {
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

inline void check_within_limits(const std::vector<rcs::StreamPoint>& points) {
  const Worst worst = worst_of(points, kRate);
  CHECK(worst.speed <= 1.01);
  CHECK(worst.acceleration <= 1.01);
  CHECK(worst.jerk <= 1.01);
  CHECK(worst.outside == 0);
  if (worst.speed > 1.01 || worst.acceleration > 1.01 || worst.jerk > 1.01)
    std::fprintf(stderr, "  %.4f %.4f %.4f of the limits\n", worst.speed, worst.acceleration, worst.jerk);
}

inline bool is_still(const rcs::StreamPoint& point) {
  return std::ranges::all_of(point.velocity, [](double v) { return v == 0.0; });
}

inline std::string message_of(auto call) {
  try {
    call();
  } catch (const std::exception& error) {
    return error.what();
  }
  return "";
}

inline bool has(const std::string& text, const char* part) { return text.find(part) != std::string::npos; }

template <typename Condition>
void await(Condition condition) {
  for (int k = 0; k < 5000 && !condition(); ++k) std::this_thread::sleep_for(1ms);
  CHECK(condition());
}

}  // namespace rcs::test
