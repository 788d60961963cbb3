#include "rcs/hosted.hpp"

#include <pthread.h>
#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cmath>
#include <cstring>
#include <sstream>
#include <thread>
#include <utility>
#include <vector>

#include "host_memory.hpp"
#include "rcs/result.hpp"

namespace rcs {

namespace {

/// How long a command waits for the host to have taken it [s]; what goes wrong later is a fault.
constexpr double kPatience = 0.01;
/// How often the program shows that it runs, and looks after the host [s].
constexpr double kLook = 0.02;

/// Set while this thread tells the device of a fault of the host: there is nobody to hold it then, or it is held.
thread_local bool t_is_telling = false;

void tell(Device& device, const std::string& reason) {
  t_is_telling = true;
  device.set_fault(reason);
  t_is_telling = false;
}

bool has_come(std::uint32_t done, std::uint32_t number) { return static_cast<std::int32_t>(done - number) >= 0; }

/// How a process of ours has ended, in words; of others nobody knows.
std::string how_it_ended(int process) {
  for (int tries = 0; tries < 50; ++tries) {
    siginfo_t about{};
    if (waitid(P_PID, static_cast<id_t>(process), &about, WEXITED | WNOHANG | WNOWAIT) != 0) break;
    if (about.si_pid == process)
      return about.si_code == CLD_EXITED
                 ? " ended with exit code " + std::to_string(about.si_status)
                 : " ended with signal " + std::to_string(about.si_status) + " (" + strsignal(about.si_status) + ")";
    std::this_thread::sleep_for(std::chrono::milliseconds(2));
  }
  return " ended";
}

}  // namespace

/// One connection to a host.
class HostLink {
 public:
  /// With `is_recovering`, faults are not told before `recover`.
  HostLink(Device& device, const HostConnection& connection, double answer, bool is_recovering = false)
      : device_(device),
        answer_(answer),
        socket_(connection.socket),
        process_(connection.process),
        process_file_(open_process(connection.process)),
        memory_(mapped(connection)),
        is_recovering_(is_recovering) {
    memory_->sign_of_program = host_clock();
    thread_ = std::thread([this] { look_after(); });
  }

  ~HostLink() {
    ends_ = true;
    wake_all(memory_->changes_of_fault);
    thread_.join();
    ::close(socket_);
    if (process_file_ >= 0) ::close(process_file_);
    unmap_host_memory(memory_);
  }

  int process() const { return process_; }
  bool is_lost() const { return is_lost_; }

  [[noreturn]] void refuse() {
    std::string reason;
    {
      const std::lock_guard lock(mutex_);
      reason = reason_;
    }
    tell(device_, reason);
    throw DeviceFault(device_.name() + ": " + reason);
  }

  /// Ask for a call and wait for its end, or until a command is late.
  HostAnswer ask(HostCall call, std::span<const double> values = {}, double valid_for = kForever, double force = kNaN,
                 double period = 0.0) {
    const bool is_command = call <= HostCall::opening;
    if (!is_command) await_end(asked_, kForever);
    tell_of_late_refusal();
    HostAsked asked{};
    asked.number = ++asked_;
    asked.stops = memory_->stops;
    asked.call = call;
    asked.count = static_cast<std::int32_t>(values.size());
    std::ranges::copy(values, asked.values.begin());
    asked.force = force;
    asked.period = period;
    asked.valid_until = valid_for < 1e9 ? host_clock() + static_cast<std::int64_t>(valid_for * 1e9) : INT64_MAX;
    memory_->request.write(asked);
    memory_->asked = asked.number;
    wake_all(memory_->asked);
    HostAnswer answer{};
    if (!await_end(asked.number, is_command ? kPatience : kForever)) {
      late_ = asked.number;
      return answer;
    }
    if (memory_->answer.read(answer) && answer.number == asked.number) require_done(answer);
    return answer;
  }

  void recover() {
    // Faults from before must not count as new ones.
    struct Recovering {
      std::atomic<bool>& is_recovering;
      ~Recovering() { is_recovering = false; }
    } const recovering{is_recovering_};
    is_recovering_ = true;
    ask(HostCall::recover);
    seen_ = memory_->changes_of_fault.load();
    HostText<512> fault{};
    if (memory_->fault.read(fault) && fault.characters[0] != '\0') throw DeviceFault(fault.get());
  }

  void hold() {
    if (is_lost_) refuse();
    ++memory_->stops;
    const std::uint32_t number = ++memory_->hold_asked;
    wake_all(memory_->hold_asked);
    const std::int64_t limit = host_clock() + static_cast<std::int64_t>(answer_ * 1e9);
    while (true) {
      const std::uint32_t held = memory_->held;
      if (has_come(held, number)) break;
      if (is_lost_) refuse();
      if (host_clock() > limit) {
        lose(hangs("hold"), true);
        refuse();
      }
      await_change(memory_->held, held, kLook);
    }
    HostText<512> failure{};
    if (memory_->hold_failure.read(failure) && failure.characters[0] != '\0') throw DeviceFault(failure.get());
  }

  HostMeasured measured() {
    if (is_lost_) refuse();
    HostMeasured measured{};
    if (!memory_->measured.read(measured)) measured.failure.set("the host ended while it wrote a measurement");
    if (const std::string failure = measured.failure.get(); !failure.empty()) {
      tell(device_, failure);
      throw DeviceFault(device_.name() + ": " + failure);
    }
    return measured;
  }

 private:
  static HostMemory* mapped(const HostConnection& connection) {
    if (connection.process <= 1)  // those are no hosts, and a host that hangs is killed
      throw InvalidSetup("the number of a host's process is " + std::to_string(connection.process));
    HostMemory* memory = map_host_memory(connection.memory);
    ::close(connection.memory);
    return memory;
  }

  std::string who() const { return "the host of " + device_.name() + " (process " + std::to_string(process_) + ")"; }

  std::string hangs(const std::string& call) const {
    return who() + " hangs: it did not return from " + call + " in time, and was killed";
  }

  void require_done(const HostAnswer& answer) {
    if (answer.outcome != HostOutcome::done) told_ = answer.number;
    const std::string text = answer.text.get();
    switch (answer.outcome) {
      case HostOutcome::done:
        return;
      case HostOutcome::invalid:
        throw InvalidCommand(text);
      case HostOutcome::wrong_order:
        throw WrongOrder(text);
      case HostOutcome::fault:
        tell(device_, text);
        throw DeviceFault(device_.name() + ": " + text);
    }
  }

  /// False when the time [s] is over first. The host's promise, which the thread looks after, bounds all waiting.
  bool await_end(std::uint32_t number, double seconds) {
    const double limit = monotonic_time() + seconds;
    while (true) {
      if (is_lost_) refuse();
      const std::uint32_t done = memory_->done;
      if (has_come(done, number)) return true;
      const double left = limit - monotonic_time();
      if (left <= 0.0) return false;
      await_change(memory_->done, done, std::min(left, kLook));
    }
  }

  void lose(const std::string& reason, bool kills) {
    {
      const std::lock_guard lock(mutex_);
      if (is_lost_) return;
      reason_ = reason;
      is_lost_ = true;
    }
    if (kills) ::kill(process_, SIGKILL);
    wake_all(memory_->done);
    wake_all(memory_->held);
    tell(device_, reason);
  }

  void look_after() {
    pthread_setname_np(pthread_self(), "rcs host link");
    sigset_t all;
    sigfillset(&all);
    pthread_sigmask(SIG_BLOCK, &all, nullptr);  // signals are for the threads of the program
    Overdue overdue;
    while (!ends_ && !is_lost_) {
      memory_->sign_of_program = host_clock();
      await_change(memory_->changes_of_fault, seen_, kLook);
      if (ends_) return;
      const bool has_ended = is_gone(socket_, process_file_);
      tell_of_fault();  // the last thing that it said comes first
      HostText<64> call{};
      if (has_ended) {
        lose(who() + how_it_ended(process_), false);
      } else if (overdue.look(memory_->next_sign)) {
        memory_->under_way.read(call);
        lose(hangs(call.get()), true);
      } else {
        tell_of_late_refusal();
      }
    }
  }

  void tell_of_fault() {
    const std::uint32_t now = memory_->changes_of_fault;
    if (now == seen_ || is_recovering_) return;
    HostText<512> fault{};
    if (!memory_->fault.read(fault)) return;
    seen_ = now;
    if (fault.characters[0] != '\0') tell(device_, fault.get());
  }

  void tell_of_late_refusal() {
    const std::uint32_t late = late_;
    HostAnswer refusal{};
    if (late == 0 || !memory_->refusal.read(refusal)) return;
    if (refusal.number == 0 || !has_come(late, refusal.number)) return;
    if (told_.exchange(refusal.number) == refusal.number || is_recovering_) return;
    tell(device_, "a command was refused late: " + refusal.text.get());
  }

  Device& device_;
  const double answer_;
  const int socket_, process_, process_file_;
  HostMemory* const memory_;
  std::uint32_t asked_ = 0;
  std::atomic<std::uint32_t> seen_ = 0;  // changes of the host's fault that the device was told of
  std::atomic<bool> is_recovering_;
  std::atomic<std::uint32_t> late_ = 0;  // the newest command whose end nobody has waited for
  std::atomic<std::uint32_t> told_ = 0;  // the newest refusal that somebody knows of
  std::atomic<bool> is_lost_ = false;
  std::atomic<bool> ends_ = false;
  std::mutex mutex_;
  std::string reason_;
  std::thread thread_;
};

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
  if (link && !link->is_lost()) link->ask(HostCall::close);
}

void HostLine::hold() {
  if (t_is_telling) return;
  if (const auto link = this->link()) link->hold();
}

void HostLine::recover() {
  auto link = this->link();
  if (link->is_lost()) {
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
  if (period * rate_ < 1.0 || period >= 10.0)
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
