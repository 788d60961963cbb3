// The thread that leads a streamed arm from tick to tick, and what it exchanges with those that use the arm.
#pragma once

#include <time.h>

#include <algorithm>
#include <atomic>
#include <cmath>
#include <exception>
#include <mutex>
#include <sstream>
#include <thread>
#include <utility>

#include "fork.hpp"
#include "newest.hpp"
#include "rcs/result.hpp"
#include "rcs/streamed_arm.hpp"
#include "real_time.hpp"
#include "stream_leader.hpp"

namespace rcs {

// Periods after which a target that no other one follows is the last of its stream. A plan lasts for two.
inline constexpr double kPatience = 1.5;
// How long `recover` and `guide` wait for the arm's thread besides what the vendor's functions take [s].
inline constexpr double kAnswerTime = 2.0;
// How many times as long as `silence` the vendor's `stop` may take, and what waits for power and brakes.
inline constexpr double kStopping = 8.0, kStarting = 60.0;
// How long an arm may take to come to rest [s] when it is closed; one that its controller brakes is then stopped.
inline constexpr double kBrakingTime = 1.0;

inline MotionLimits motion_limits(const std::string& name, const ArmLimits& limits) {
  if (limits.joint_acceleration.empty() || limits.joint_jerk.empty())
    throw InvalidSetup(name + ": a streamed arm needs limits of acceleration and jerk for every joint");
  return {limits.joint_lower, limits.joint_upper, limits.joint_velocity, limits.joint_acceleration, limits.joint_jerk};
}

// The data of the arm's thread, and its exchange with others. Members are the thread's unless they say otherwise.
struct StreamedArm::Loop {
  struct Order {
    std::uint64_t number = 0;
    double deadline = kForever;
    CommandKind kind = CommandKind::joints;
    std::vector<double> values;
  };
  struct Seen {
    ArmState state;
    std::uint64_t done = 0;
    std::uint64_t holds = 0;
    bool is_still = true;
    CommandKind kind = CommandKind::joints;
  };
  enum class Request : std::uint8_t { none, clear, give_way };

  explicit Loop(StreamedArm& arm)
      : arm(arm), leader(motion_limits(arm.name(), arm.limits()), arm.options_), period(arm.options_.period) {}

  // --- Called by others.

  void begin() {
    for (auto* count : {&sent, &held, &holds, &rested, &ticks, &missed, &lapses}) *count = 0;
    leader.forget_counts();
    is_led = is_closing = is_abandoned = is_starting = false;
    real_time.forget();
    is_reading = true;
    gave_way = is_asked = is_braking = false;
    kind = CommandKind::joints;
    done = taken_holds = 0;
    last_tick = closing_since = kForever;
    orders.take();  // orders that were too late before the last close
    arm.connect();
    read();
    publish();
    forked = forks();
    is_running = false;
    thread = std::thread([this] { run(); });
    is_running.wait(false);
  }

  double silence() const { return monotonic_time() - last_tick; }

  std::string silent_text() const {
    std::ostringstream text;
    text << "the controller has not answered for " << monotonic_time() - called_at
         << " s: look at its state, its power and its cable; the last call to it has not returned";
    return text.str();
  }

  // Have the thread do something and wait for it; what the vendor throws is thrown here.
  void ask(Request what) {
    if (is_answering) throw DeviceFault(arm.name() + ": " + silent_text());  // the last question, which timed out
    failure = nullptr;
    request = what;
    for (double waited = 0.0; request != Request::none; waited = std::max(waited, silence())) {
      if (waited > kAnswerTime) {
        request = Request::none;
        throw DeviceFault(arm.name() + ": " + silent_text());
      }
      std::this_thread::sleep_for(std::chrono::milliseconds(1));
    }
    if (failure) std::rethrow_exception(std::exchange(failure, nullptr));
  }

  void end() {
    is_closing = true;
    if (!thread.joinable()) return;
    if (forked == forks())
      thread.join();
    else
      thread.detach();  // it is the parent's
  }

  // --- The thread.

  void run() {
    thread_id = std::this_thread::get_id();
    real_time.request();
    is_running = true;
    is_running.notify_all();
    const double tick_time = 1.0 / arm.options_.rate;
    int late = 0;
    next = monotonic_time();
    last_tick = next;
    while (tick(late)) {
      if (arm.options_.is_paced_by_read && is_reading) {
        late = 0;
        continue;
      }
      // On multiples of the period, all arms of one rate tick at the same moments and follow together what they are
      // commanded at once.
      next = (std::floor(next * arm.options_.rate + 0.5) + 1.0) / arm.options_.rate;
      const timespec until{static_cast<time_t>(next), static_cast<long>((next - std::floor(next)) * 1e9)};
      while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &until, nullptr) == EINTR) continue;
      const auto left_out = static_cast<int>(std::clamp((monotonic_time() - next) / tick_time, 0.0, 1e6));
      late = left_out > 0 ? late + left_out : 0;
      missed += static_cast<std::uint64_t>(left_out);
      next += left_out * tick_time;
    }
  }

  // Whether there is a next one.
  bool tick(int late) {
    last_tick = called_at = monotonic_time();
    if (is_reading) try_to("read", [this] { read(); });
    if (is_abandoned.exchange(false)) {
      if (gave_way.exchange(false)) is_led = true;  // as a led one: stopped, and not started before `recover`
      break_down(silent_text());
    }
    if (is_led && late > arm.options_.missed_ticks) {
      const std::string advice = real_time.advice();
      break_down("the arm's thread came " + std::to_string(late) + " ticks too late: this machine is busy" +
                 (advice.empty() ? "" : "; ") + advice);
    }
    answer();
    if (is_led && kind == CommandKind::joints) check_tracking();
    take_orders();
    if (is_led) kind == CommandKind::joints ? lead() : lead_otherwise();
    publish();
    is_starting = false;  // what is published is new again
    if (stands()) rested = taken_holds;
    if (!is_closing) return true;
    closing_since = std::min(closing_since, last_tick.load());
    const bool is_overdue = kind != CommandKind::joints && last_tick - closing_since > kBrakingTime;
    if (is_led && (stands() || is_overdue)) {
      is_led = false;
      try_to("stop", [this] { arm.stop(); });
    }
    return is_led;
  }

  bool stands() { return !is_led || (kind == CommandKind::joints && leader.is_still()); }

  void lead_otherwise() {
    bool has_come_to_rest = false;
    const bool is_done = try_to("write", [&] {
      if (is_braking)
        has_come_to_rest = arm.brake_other();
      else
        arm.write_other(kind, values);
      ++ticks;
    });
    if (is_done && has_come_to_rest) stand();
  }

  // Have the vendor do something that may take so many times as long as `silence`.
  template <typename Call>
  void take_time(double times, Call call) {
    called_at = monotonic_time();
    last_tick = called_at + times * arm.options_.silence;
    call();
    last_tick = called_at = next = monotonic_time();
  }

  template <typename Call>
  bool try_to(const char* what, Call call) {
    try {
      call();
      return true;
    } catch (const std::exception& error) {
      break_down(what, error);
    }
    return false;
  }

  void read() {
    // A state that is refused must not be published: others index its rows.
    fresh = measured;
    fresh.time = fresh.device_time = kNaN;
    arm.read(fresh);
    const auto n = static_cast<std::size_t>(arm.dof());
    if (fresh.joints.size() != n || fresh.joint_velocities.size() != n)
      throw DeviceFault("the device measured " + std::to_string(fresh.joints.size()) + " joints, it has " +
                        std::to_string(n));
    for (std::size_t i = 0; i < n; ++i)
      if (!std::isfinite(fresh.joints[i]) || !std::isfinite(fresh.joint_velocities[i]))
        throw DeviceFault("the device measured a value that is not finite at joint " + std::to_string(i));
    if (const auto given = fresh.commanded_joints.size(); given != 0 && given != n)
      throw DeviceFault("the device measured " + std::to_string(given) + " commanded joints, it has " +
                        std::to_string(n));
    if (std::isnan(fresh.time)) fresh.time = monotonic_time();
    std::swap(measured, fresh);
  }

  // Stop first: an exception from Python waits for the interpreter to give its message.
  void break_down(const std::string& what, const std::exception& error) {
    is_breaking = true;
    const std::string failure = stop_leading();
    take_time(kStarting, [&] {
      const bool is_said = dynamic_cast<const DeviceFault*>(&error);
      const std::string reason = (is_said ? "" : what + " failed: ") + words_of(error) + failure;
      if (what == "read") is_reading = false;  // not before: whoever finds it so only knows that the link is lost
      arm.set_fault(reason);
    });
    is_breaking = false;
  }
  void break_down(const std::string& reason) {
    is_breaking = true;
    const std::string failure = stop_leading();
    take_time(kStarting, [&] { arm.set_fault(reason + failure); });
    is_breaking = false;
  }

  std::string words_of(const std::exception& error) const {
    const auto words = arm.words_of(error);
    return words ? *words : error.what();
  }

  // Returns what to say of a controller that could not be stopped.
  std::string stop_leading() {
    std::string text;
    if (!is_led.exchange(false)) return text;
    is_asked = false;
    take_time(kStopping, [&] {
      try {
        arm.stop();
      } catch (const std::exception& error) {
        text = "; stop failed: " + words_of(error);
      }
    });
    return text;
  }

  void answer() {
    const Request what = request;
    if (what == Request::none) return;
    is_answering = true;
    if (what == Request::clear) end_guiding();  // the hold that ended it comes with the fault
    try {
      take_time(kStarting, [&] {
        if (what == Request::give_way) {
          // Earlier commands end with it. A hold that is made meanwhile is made again by `Device::command`.
          done = sent;
          taken_holds = holds;
          is_led = is_asked = false;
          arm.give_way();
          gave_way = true;
        } else if (!is_led) {  // where it is led, the controller is well
          arm.clear();
          read();
          is_reading = true;
        }
      });
    } catch (...) {
      failure = std::current_exception();
      last_tick = next = monotonic_time();
      if (what == Request::give_way) {
        is_led = true;  // it may have given way in part, and nobody else would hold it
        if (const std::string text = stop_leading(); !text.empty())
          take_time(kStarting, [&] { arm.set_fault("guide failed" + text); });
      }
    }
    is_answering = false;
    request = Request::none;
  }

  void check_tracking() {
    const std::span<const double> led = leader.position();
    for (std::size_t i = 0; i < led.size(); ++i) {
      if (std::abs(measured.joints[i] - led[i]) <= arm.options_.tracking_error) continue;
      std::ostringstream text;
      text << "joint " << i << " is at " << measured.joints[i] << " rad and was led to " << led[i]
           << " rad, farther apart than " << arm.options_.tracking_error
           << " rad: it is blocked or overloaded, or its motor is off";
      return break_down(text.str());
    }
  }

  void take_orders() {
    const double now = monotonic_time();
    if (const std::uint64_t all = holds; all != taken_holds) {
      taken_holds = all;
      done = std::max(done, held.load());
      if (is_asked && now >= deadline) ++lapses;  // whoever keeps it
      end_guiding();
      brake();
    }
    if (is_closing) return brake();
    if (orders.is_fresh()) {
      const Order& order = orders.take();
      if (order.number <= done) return;
      done = order.number;
      if (!arm.fault().empty()) return;  // it was set between the check of this command and its sending
      deadline = order.deadline;
      if (now < deadline && (is_led || start())) {
        if (order.kind != kind && !stands()) return brake();  // it preceded this one
        kind = order.kind;
        if (kind == CommandKind::joints)
          leader.follow(order.values, period);
        else
          values = order.values;
        is_asked = true;
        is_braking = false;
        since = 0;
        return;
      }
    }
    if (!is_asked) return;
    if (now >= deadline) {
      ++lapses;
      brake();
    } else if (kind == CommandKind::joints && ++since > kPatience * period * arm.options_.rate) {
      leader.go_on(period);
      since = 0;
    }
  }

  // Lead it again. One that cannot be led is stopped: it would stay free.
  void end_guiding() {
    if (!gave_way.exchange(false)) return;
    is_led = true;
    start();
  }

  bool start() {
    is_starting = true;
    return try_to("start", [this] { stand_up(); });
  }

  // From here on the arm is led, at first to where it is.
  void stand_up() {
    take_time(kStarting, [this] {
      arm.start();
      is_led = true;  // from here on, what fails stops it
      read();
      is_reading = true;  // it may have failed while a person guided the arm
    });
    stand();
  }

  // Led to where it is.
  void stand() {
    kind = CommandKind::joints;
    leader.stand(measured.joints);
    is_asked = is_braking = false;
  }

  void brake() {
    if (kind != CommandKind::joints)
      is_braking = true;
    else if (is_led)
      leader.brake();
    is_asked = false;
  }

  void lead() {
    const StreamPoint* point = nullptr;
    if (!try_to("box", [&] { point = &leader.advance(); })) return;
    try_to("write", [&] {
      arm.write(*point);
      ++ticks;
    });
  }

  void publish() {
    Seen& now = seen.next();
    now.state = measured;
    if (now.state.commanded_joints.empty() && is_led && kind == CommandKind::joints)
      now.state.commanded_joints.assign(leader.target().begin(), leader.target().end());
    now.done = done;
    now.holds = taken_holds;
    now.is_still = stands();
    now.kind = kind;
    seen.publish();
  }

  StreamedArm& arm;
  StreamLeader leader;

  // Exchanged with other threads.
  std::mutex user;  // of those that use the arm; its thread never takes it
  Newest<Order> orders;
  Newest<Seen> seen;
  std::atomic<double> period, last_tick = kForever, called_at = kForever;
  std::atomic<std::uint64_t> sent = 0;    // commands so far
  std::atomic<std::uint64_t> held = 0;    // of these, the ones before the last order to hold
  std::atomic<std::uint64_t> holds = 0;   // orders to hold so far
  std::atomic<std::uint64_t> rested = 0;  // of these, the last one after which the arm stood still
  std::atomic<std::uint64_t> ticks = 0, missed = 0, lapses = 0;
  std::atomic<bool> is_running = false, is_led = false, is_closing = false, is_reading = true;
  std::atomic<bool> is_starting = false;   // for a command that was near, until the next measurement is published
  std::atomic<bool> is_breaking = false;   // it has stopped, and its fault is about to be set
  std::atomic<bool> is_abandoned = false;  // another thread stopped it because it did not answer
  RealTime real_time;
  std::atomic<Request> request = Request::none;
  std::atomic<bool> is_answering = false;
  std::exception_ptr failure;  // of the request

  std::thread thread;
  std::atomic<std::thread::id> thread_id;
  unsigned forked = 0;
  double next = 0.0;                // s, when the next tick is
  double closing_since = kForever;  // s
  ArmState measured, fresh;         // `fresh` is not checked yet
  double deadline = kForever;
  std::uint64_t done = 0, taken_holds = 0;
  int since = 0;                           // ticks since it was followed
  bool is_asked = false;                   // there is a command to follow
  std::atomic<bool> gave_way = false;      // also read by who holds
  CommandKind kind = CommandKind::joints;  // what the arm is led by
  std::vector<double> values;              // of the last command, where that was another kind than joints
  bool is_braking = false;                 // from another kind than joints
};

}  // namespace rcs
