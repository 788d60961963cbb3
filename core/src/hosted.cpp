#include "rcs/hosted.hpp"

#include <utility>
#include <vector>

#include "host_link.hpp"
#include "host_memory.hpp"
#include "rcs/result.hpp"

namespace rcs {

HostLine::HostLine(Device& device, Connect connect, double answer)
    : device_(device), connect_(std::move(connect)), answer_(answer) {}

HostLine::~HostLine() = default;

std::shared_ptr<HostLink> HostLine::link() const {
  const std::lock_guard lock(mutex_);
  return link_;
}

std::shared_ptr<HostLink> HostLine::exchange(std::shared_ptr<HostLink> link) {
  const std::lock_guard lock(mutex_);
  return std::exchange(link_, std::move(link));
}

int HostLine::process() const {
  const auto link = this->link();
  return link && !link->is_lost() ? link->process() : 0;
}

void HostLine::open() { exchange(std::make_shared<HostLink>(device_, connect_(), answer_)); }

void HostLine::close() {
  const auto link = exchange(nullptr);
  if (link && !link->is_lost()) link->close();
}

void HostLine::hold() {
  if (HostLink::is_telling()) return;
  if (const auto link = this->link()) link->hold();
}

void HostLine::settle() {
  if (const auto link = this->link()) link->settle();
}

void HostLine::recover() {
  auto link = this->link();
  if (link->is_lost()) {
    link->settle();  // it may be lost only now, and its thread must not outlive the last reference to it
    link = std::make_shared<HostLink>(device_, connect_(), answer_, true);  // if it throws, the lost one stays
    exchange(link);
  }
  link->recover();  // a new host, too: its device may be in the fault state that the end of the last one led to
}

void HostLine::guide() { link()->ask(HostCall::guide); }
bool HostLine::has_arrived() { return link()->ask(HostCall::has_arrived).flag != 0; }
HostMeasured HostLine::measured() { return link()->measured(); }

void HostLine::command(HostCall call, std::span<const double> values, double valid_for, double force, double period) {
  link()->ask(call, values, valid_for, force, period);
}

namespace {

std::vector<double> values_of(const HostMeasured& measured, std::size_t which) {
  const auto& values = measured.values[which];
  return {values.begin(), values.begin() + measured.counts[which]};
}

void require_room(const std::string& name, int joints) {
  if (joints <= static_cast<int>(kHostValues)) return;
  throw InvalidSetup(name + " has " + std::to_string(joints) + " joints; a device with a host has at most " +
                     std::to_string(kHostValues) + "; give it the option \"host\": false");
}

}  // namespace

HostedArm::HostedArm(const Arm& like, HostLine::Connect connect, double answer)
    : Hosted<Arm>(like.can_guide(), std::move(connect), answer, like.name(), like.limits(), like.commands()) {
  require_room(name(), dof());
  if (const auto* streamed = dynamic_cast<const StreamedArm*>(&like)) {
    rate_ = streamed->options().rate;
    period_ = streamed->period();
  }
}

void HostedArm::set_period(double period) {
  if (!(period * rate_ >= 1.0 && period < 10.0))  // so that NaN is refused
    throw InvalidSetup(name() + ": valid is a period of commands from one tick to 10 s, of a streamed arm");
  period_ = period;
}

Clamped HostedArm::clamped() const {
  const std::lock_guard lock(mutex_);
  return clamped_;
}

ArmState HostedArm::do_state() {
  const HostMeasured measured = line_.measured();
  {
    const std::lock_guard lock(mutex_);
    clamped_ = measured.clamped;
  }
  return {values_of(measured, 0), values_of(measured, 1), measured.time,          measured.device_time,
          values_of(measured, 2), values_of(measured, 3), values_of(measured, 4), measured.mode.get()};
}

void HostedArm::send(HostCall call, std::span<const double> values) {
  line_.command(call, values, valid_for(), kNaN, period_);
}
void HostedArm::do_command_joints(std::span<const double> joints) { send(HostCall::joints, joints); }
void HostedArm::do_command_pose(const Pose& pose_tcp_in_base) { send(HostCall::pose, pose_tcp_in_base.tquat()); }
void HostedArm::do_command_twist(std::span<const double> twist) { send(HostCall::twist, twist); }
void HostedArm::do_command_velocities(std::span<const double> velocities) { send(HostCall::velocities, velocities); }
void HostedArm::do_command_torques(std::span<const double> torques) { send(HostCall::torques, torques); }

HostedGripper::HostedGripper(const Gripper& like, HostLine::Connect connect, double answer)
    : Hosted<Gripper>(like.can_guide(), std::move(connect), answer, like.name(), like.max_width(), like.max_force()) {}

GripperState HostedGripper::do_state() {
  const HostMeasured measured = line_.measured();
  return {measured.opening, measured.force, measured.time, measured.device_time};
}

void HostedGripper::do_command_opening(double opening, std::optional<double> force) {
  line_.command(HostCall::opening, std::span(&opening, 1), valid_for(), force.value_or(kNaN));
}

HostedHand::HostedHand(const Hand& like, HostLine::Connect connect, double answer)
    : Hosted<Hand>(like.can_guide(), std::move(connect), answer, like.name(), like.joint_count()) {
  require_room(name(), joint_count());
}

HandState HostedHand::do_state() {
  const HostMeasured measured = line_.measured();
  return {values_of(measured, 0), measured.time, measured.device_time};
}

void HostedHand::do_command_joints(std::span<const double> joints) {
  line_.command(HostCall::joints, joints, valid_for());
}

}  // namespace rcs
