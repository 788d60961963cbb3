#include "rcs/streamed_arm.hpp"

#include <pthread.h>
#include <sys/mman.h>
#include <sys/resource.h>
#include <time.h>

#include <algorithm>
#include <cmath>
#include <csignal>
#include <exception>
#include <sstream>
#include <thread>
#include <utility>

#include "fork.hpp"
#include "newest.hpp"
#include "rcs/result.hpp"
#include "stream_leader.hpp"

namespace rcs {

namespace {

// Periods after which a target that no other one follows is the last of its stream. A plan lasts for two.
constexpr double kPatience = 1.5;
// At rest, for arrival: ten times above what a servo jitters [rad/s].
constexpr double kVelocityTolerance = 1e-2;
// How long `recover` and `guide` wait for the arm's thread besides what the vendor's functions take [s].
constexpr double kAnswerTime = 2.0;
// How long a program that ends waits for its arms to brake [s].
constexpr double kBrakingTime = 1.0;
// Above what interrupts of a real-time kernel have, 50; the kernel's own watchdogs are at 99.
constexpr int kPriority = 80;

constexpr const char* kLost = "the link to the controller is lost";

MotionLimits motion_limits(const std::string& name, const ArmLimits& limits) {
  if (limits.joint_acceleration.empty() || limits.joint_jerk.empty())
    throw InvalidSetup(name + ": a streamed arm needs limits of acceleration and jerk for every joint");
  return {limits.joint_lower, limits.joint_upper, limits.joint_velocity, limits.joint_acceleration, limits.joint_jerk};
}

void check_options(const std::string& name, const ArmLimits& limits, const StreamOptions& options) {
  const auto require = [&](bool is_valid, const char* what) {
    if (!is_valid) throw InvalidSetup(name + ": " + what);
  };
  require(options.rate >= 10.0 && options.rate <= 2000.0, "valid is a rate of 10 to 2000 Hz");
  require(options.period * options.rate >= 1.0 && options.period < 10.0,
          "valid is a period of commands from one tick to 10 s");
  require(options.first_step > 0.0 && options.tracking_error > 0.0 && options.arrival > 0.0 && options.silence > 0.0,
          "first_step, tracking_error, arrival and silence must be positive");
  require(options.missed_ticks > 0, "missed_ticks must be positive");
  for (std::size_t i = 0; i < limits.joint_lower.size(); ++i)
    require(options.margin >= 0.0 && 2.0 * options.margin < limits.joint_upper[i] - limits.joint_lower[i],
            "the margin must be 0 or more, and leave every joint some of its range");
  if (!options.box) return;
  require(static_cast<bool>(options.box->tcp), "the box needs a function that gives the TCP");
  for (std::size_t i = 0; i < 3; ++i)
    require(options.box->lower[i] < options.box->upper[i], "every lower bound of the box must be below the upper one");
}

}  // namespace

// What the arm's thread has, and what others exchange with it. Members are the thread's unless they say otherwise.
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
    is_led = is_closing = is_abandoned = has_priority = has_locked = false;
    is_reading = true;
    gave_way = is_asked = is_braking = false;
    kind = CommandKind::joints;
    done = taken_holds = 0;
    last_tick = kForever;
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
    text << "the controller has not answered for " << silence()
         << " s: look at its state, its power and its cable; the last call to it has not returned";
    return text.str();
  }

  // Have the thread do something and wait for it; what the vendor throws is thrown here.
  void ask(Request what) {
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
    become_real_time();
    is_running = true;
    is_running.notify_all();
    const double tick_time = 1.0 / arm.options_.rate;
    int late = 0;
    next = monotonic_time();
    last_tick = next;
    while (tick(late)) {
      if (arm.options_.is_paced_by_read && is_reading) continue;
      next += tick_time;
      const timespec until{static_cast<time_t>(next), static_cast<long>((next - std::floor(next)) * 1e9)};
      while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &until, nullptr) == EINTR) continue;
      const auto left_out = static_cast<int>(std::clamp((monotonic_time() - next) / tick_time, 0.0, 1e6));
      late = left_out > 0 ? late + left_out : 0;
      missed += static_cast<std::uint64_t>(left_out);
      next += left_out * tick_time;
    }
  }

  void become_real_time() {
    pthread_setname_np(pthread_self(), "rcs arm");
    sigset_t all;
    sigfillset(&all);
    pthread_sigmask(SIG_BLOCK, &all, nullptr);  // signals are for the threads of the program
    const sched_param priority{kPriority};
    has_priority = pthread_setschedparam(pthread_self(), SCHED_FIFO, &priority) == 0;
    // Under a limit, locking what is to come would make later allocations of the program fail.
    rlimit limit{};
    has_locked = getrlimit(RLIMIT_MEMLOCK, &limit) == 0 && limit.rlim_cur == RLIM_INFINITY &&
                 mlockall(MCL_CURRENT | MCL_FUTURE | MCL_ONFAULT) == 0;
  }

  // Whether there is a next one.
  bool tick(int late) {
    last_tick = monotonic_time();
    if (is_reading) try_to("read", [this] { read(); });
    if (is_abandoned.exchange(false)) break_down(silent_text());
    if (is_led && late > arm.options_.missed_ticks) {
      const std::string advice = this->advice();
      break_down("the arm's thread came " + std::to_string(late) + " ticks too late: this machine is busy" +
                 (advice.empty() ? "" : "; ") + advice);
    }
    answer();
    if (is_led && kind == CommandKind::joints) check_tracking();
    take_orders();
    if (is_led) kind == CommandKind::joints ? lead() : lead_otherwise();
    publish();
    if (stands()) rested = taken_holds;
    if (!is_closing) return true;
    if (is_led && stands()) {
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

  // Have the vendor do something that may take long, of which no deadline is kept.
  template <typename Call>
  void take_time(Call call) {
    last_tick = kForever;
    call();
    last_tick = next = monotonic_time();
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
    measured.time = measured.device_time = kNaN;
    arm.read(measured);
    const auto n = static_cast<std::size_t>(arm.dof());
    if (measured.joints.size() != n || measured.joint_velocities.size() != n)
      throw DeviceFault("the device measured " + std::to_string(measured.joints.size()) + " joints, it has " +
                        std::to_string(n));
    for (std::size_t i = 0; i < n; ++i)
      if (!std::isfinite(measured.joints[i]) || !std::isfinite(measured.joint_velocities[i]))
        throw DeviceFault("the device measured a value that is not finite at joint " + std::to_string(i));
    if (std::isnan(measured.time)) measured.time = monotonic_time();
  }

  // Stop first: an exception from Python waits for the interpreter to give its message.
  void break_down(const std::string& what, const std::exception& error) {
    is_breaking = true;
    const std::string failure = stop_leading();
    if (what == "read") is_reading = false;
    take_time([&] {
      const bool is_said = dynamic_cast<const DeviceFault*>(&error);
      arm.set_fault((is_said ? "" : what + " failed: ") + words_of(error) + failure);
    });
    is_breaking = false;
  }
  void break_down(const std::string& reason) {
    is_breaking = true;
    const std::string failure = stop_leading();
    take_time([&] { arm.set_fault(reason + failure); });
    is_breaking = false;
  }

  std::string words_of(const std::exception& error) const { return arm.words_of(error).value_or(error.what()); }

  // Returns what to say of a controller that could not be stopped.
  std::string stop_leading() {
    std::string text;
    if (!is_led.exchange(false)) return text;
    is_asked = false;
    take_time([&] {
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
    if (what == Request::clear && std::exchange(gave_way, false))
      start();  // the hold that ended it comes with the fault
    try {
      take_time([&] {
        if (what == Request::give_way) {
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
    }
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
      if (std::exchange(gave_way, false)) start();
      brake();
    }
    if (is_closing) return brake();
    if (orders.is_fresh()) {
      const Order& order = orders.take();
      if (order.number <= done) return;
      done = order.number;
      if (!arm.fault().empty()) return;  // it came between the check of this command and its sending
      deadline = order.deadline;
      if (now < deadline && (is_led || start())) {
        if (order.kind != kind && !stands()) return brake();  // it came before this one was seen
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

  bool start() {
    is_starting = true;
    const bool has_started = try_to("start", [this] { stand_up(); });
    is_starting = false;
    return has_started;
  }

  // From here on the arm is led, at first to where it is.
  void stand_up() {
    take_time([this] {
      arm.start();
      read();
    });
    stand();
    is_led = true;
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

  std::string advice() const {
    const bool priority = has_priority, locked = has_locked;
    if (priority && locked) return "";
    std::string text;
    if (!priority) text += "the arm's thread has no real-time priority, so that ticks come late on a busy machine";
    if (!locked)
      text +=
          std::string(priority ? "" : "; ") + "its memory is not locked, so that ticks come late where memory is short";
    return text + "; add the lines '@realtime - rtprio 99' and '@realtime - memlock unlimited' to " +
           "/etc/security/limits.conf, add yourself to the group realtime, and log in anew";
  }

  StreamedArm& arm;
  StreamLeader leader;

  // Exchanged with other threads.
  std::mutex user;  // of those that use the arm; its thread never takes it
  Newest<Order> orders;
  Newest<Seen> seen;
  std::atomic<double> period, last_tick = kForever;
  std::atomic<std::uint64_t> sent = 0;    // commands so far
  std::atomic<std::uint64_t> held = 0;    // of these, the ones that came before the last order to hold
  std::atomic<std::uint64_t> holds = 0;   // orders to hold so far
  std::atomic<std::uint64_t> rested = 0;  // of these, the last one after which the arm stood still
  std::atomic<std::uint64_t> ticks = 0, missed = 0, lapses = 0;
  std::atomic<bool> is_running = false, is_led = false, is_closing = false, is_reading = true;
  std::atomic<bool> is_starting = false;   // for a command that was near
  std::atomic<bool> is_breaking = false;   // it has stopped, and its fault is about to be set
  std::atomic<bool> is_abandoned = false;  // another thread stopped it because it did not answer
  std::atomic<bool> has_priority = false, has_locked = false;
  std::atomic<Request> request = Request::none;
  std::exception_ptr failure;  // of the request

  std::thread thread;
  std::atomic<std::thread::id> thread_id;
  unsigned forked = 0;
  double next = 0.0;  // s, when the next tick is
  ArmState measured;
  double deadline = kForever;
  std::uint64_t done = 0, taken_holds = 0;
  int since = 0;          // ticks since it was followed
  bool is_asked = false;  // there is a command to follow
  bool gave_way = false;
  CommandKind kind = CommandKind::joints;  // what the arm is led by
  std::vector<double> values;              // of the last command, where that was another kind than joints
  bool is_braking = false;                 // from another kind than joints
};

StreamedArm::StreamedArm(std::string name, ArmLimits limits, StreamOptions options, int built_for)
    : Arm(std::move(name), std::move(limits), options.more_commands, built_for), options_(std::move(options)) {
  check_options(this->name(), this->limits(), options_);
  loop_ = std::make_unique<Loop>(*this);
}

StreamedArm::~StreamedArm() { loop_->end(); }

double StreamedArm::period() const { return loop_->period; }

void StreamedArm::set_period(double period) {
  StreamOptions options = options_;
  options.period = period;
  check_options(name(), limits(), options);
  loop_->period = period;
}

Clamped StreamedArm::clamped() const { return loop_->leader.clamped(); }

std::uint64_t StreamedArm::ticks() const { return loop_->ticks; }
std::uint64_t StreamedArm::missed_ticks() const { return loop_->missed; }
std::uint64_t StreamedArm::lapses() const { return loop_->lapses; }
std::string StreamedArm::real_time_advice() const { return loop_->advice(); }

void StreamedArm::do_open() { loop_->begin(); }

ArmState StreamedArm::do_state() {
  if (!loop_->is_reading) fail(kLost);
  if (loop_->silence() > options_.silence) fail(loop_->silent_text());
  const std::lock_guard lock(loop_->user);
  return loop_->seen.take().state;
}

void StreamedArm::do_command_joints(std::span<const double> joints) {
  if (!loop_->is_led && !loop_->is_starting) require_near(joints);
  send(CommandKind::joints, joints);
}

void StreamedArm::require_near(std::span<const double> joints) {
  const std::lock_guard lock(loop_->user);
  const auto& measured = loop_->seen.take().state.joints;
  for (std::size_t i = 0; i < joints.size(); ++i) {
    const double distance = std::abs(joints[i] - measured[i]);
    if (distance <= options_.first_step) continue;
    if (loop_->is_breaking || !fault().empty()) return;  // the command is not followed
    std::ostringstream text;
    text << name() << ": the first target must be near the arm: joint " << i << " is at " << measured[i]
         << " rad and its target " << joints[i] << " rad is " << distance << " rad away, valid is at most "
         << options_.first_step << " rad; lead the arm from where it is";
    throw InvalidCommand(text.str());
  }
}

void StreamedArm::do_command_pose(const Pose& pose) { send(CommandKind::pose, pose.tquat()); }
void StreamedArm::do_command_twist(std::span<const double> twist) { send(CommandKind::twist, twist); }
void StreamedArm::do_command_velocities(std::span<const double> velocities) {
  send(CommandKind::velocities, velocities);
}
void StreamedArm::do_command_torques(std::span<const double> torques) { send(CommandKind::torques, torques); }

void StreamedArm::send(CommandKind kind, std::span<const double> values) {
  Loop& loop = *loop_;
  if (loop.silence() > options_.silence) fail(loop.silent_text());
  const std::lock_guard lock(loop.user);
  const Loop::Seen& seen = loop.seen.take();
  if (loop.is_led && kind != seen.kind && !seen.is_still)
    throw InvalidCommand(name() +
                         ": another kind of command than the last one is refused while the arm moves; call hold(), and "
                         "wait until it has arrived");
  Loop::Order& order = loop.orders.next();
  order.number = ++loop.sent;
  order.deadline = deadline();
  order.kind = kind;
  order.values.assign(values.begin(), values.end());
  loop.orders.publish();
}

void StreamedArm::write_other(CommandKind, std::span<const double>) {
  throw DeviceFault("the class of this arm names more commands than joints and does not override write_other");
}

bool StreamedArm::do_has_arrived() {
  Loop& loop = *loop_;
  const std::lock_guard lock(loop.user);
  const Loop::Seen& seen = loop.seen.take();
  if (seen.done != loop.sent || seen.holds != loop.holds || !seen.is_still) return false;
  const ArmState& state = seen.state;
  for (std::size_t i = 0; i < state.joints.size(); ++i) {
    if (std::abs(state.joint_velocities[i]) > kVelocityTolerance) return false;
    if (!state.commanded_joints.empty() && std::abs(state.joints[i] - state.commanded_joints[i]) > options_.arrival)
      return false;
  }
  return true;
}

void StreamedArm::do_hold() {
  Loop& loop = *loop_;
  loop.held = loop.sent.load();
  ++loop.holds;
  if (loop.thread_id == std::this_thread::get_id()) return;
  if (!loop.is_reading) throw DeviceFault(kLost);
  if (!loop.is_led || loop.silence() <= options_.silence) return;
  loop.is_abandoned = true;
  stop();
}

void StreamedArm::do_await_rest() {
  const double end = monotonic_time() + kBrakingTime;
  while (loop_->rested != loop_->holds && loop_->silence() <= options_.silence && monotonic_time() < end)
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
}

void StreamedArm::do_guide() { loop_->ask(Loop::Request::give_way); }
void StreamedArm::do_recover() { loop_->ask(Loop::Request::clear); }

void StreamedArm::do_close() {
  const bool had_fault = !fault().empty();
  loop_->end();
  disconnect();
  if (!had_fault && !fault().empty()) throw DeviceFault(name() + ": " + fault());
}

}  // namespace rcs
