#include "rcs/streamed_arm.hpp"

#include <cmath>
#include <mutex>
#include <sstream>
#include <thread>
#include <utility>

#include "open_devices.hpp"
#include "rcs/result.hpp"
#include "stream_loop.hpp"

namespace rcs {

namespace {

// At rest, for arrival: ten times above what a servo jitters [rad/s].
constexpr double kVelocityTolerance = 1e-2;

constexpr const char* kLost = "the link to the controller is lost";

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

StreamedArm::StreamedArm(std::string name, ArmLimits limits, StreamOptions options, int built_for)
    : Arm(std::move(name), std::move(limits), options.more_commands, built_for), options_(std::move(options)) {
  check_options(this->name(), this->limits(), options_);
  loop_ = std::make_unique<Loop>(*this);
}

StreamedArm::~StreamedArm() {
  // Another thread may still wait until the arm is at rest, which needs the loop.
  OpenDevices::get().remove(*this);
  OpenDevices::get().await(*this);
  loop_->end();
}

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
std::string StreamedArm::real_time_advice() const { return loop_->real_time.advice(); }

void StreamedArm::do_open() { loop_->begin(); }

ArmState StreamedArm::do_state() {
  if (!loop_->is_reading) fail(kLost);
  if (loop_->silence() > options_.silence) fail(loop_->silent_text());
  const std::lock_guard lock(loop_->user);
  const bool is_starting = loop_->is_starting;
  ArmState state = loop_->seen.take().state;
  if (is_starting) state.mode = "starting";
  return state;
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
  if (!(loop.is_led || loop.gave_way) || loop.silence() <= options_.silence) return;
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
