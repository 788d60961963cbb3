#include "host_link.hpp"

#include <pthread.h>
#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <cstring>

#include "rcs/result.hpp"

namespace rcs {

namespace {

/// How long a command waits for the host to have taken it [s]; what goes wrong later is a fault.
constexpr double kPatience = 0.01;
/// How often the program shows that it runs, and looks after the host [s].
constexpr double kLook = 0.02;

/// Set while this thread reports a fault of the host to the device: nobody can hold it then, or it is held.
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

HostMemory* mapped(const HostConnection& connection) {
  if (connection.process <= 1)  // those are no hosts, and a host that hangs is killed
    throw InvalidSetup("the number of a host's process is " + std::to_string(connection.process));
  HostMemory* memory = map_host_memory(connection.memory);
  ::close(connection.memory);
  return memory;
}

}  // namespace

HostLink::HostLink(Device& device, const HostConnection& connection, double answer, bool is_recovering)
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

HostLink::~HostLink() {
  ends_ = true;
  wake_all(memory_->changes_of_fault);
  thread_.join();
  ::close(socket_);
  if (process_file_ >= 0) ::close(process_file_);
  unmap_host_memory(memory_);
}

bool HostLink::is_telling() { return t_is_telling; }

void HostLink::refuse() {
  std::string reason;
  {
    const std::lock_guard lock(mutex_);
    reason = reason_;
  }
  tell(device_, reason);
  throw DeviceFault(device_.name() + ": " + reason);
}

HostAnswer HostLink::ask(HostCall call, std::span<const double> values, double valid_for, double force, double period) {
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

void HostLink::close() {
  closing_ = asked_ + 1;  // that of the call which follows
  ask(HostCall::close);
}

void HostLink::recover() {
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

void HostLink::hold() {
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

HostMeasured HostLink::measured() {
  if (is_lost_) refuse();
  HostMeasured measured{};
  if (!memory_->measured.read(measured)) measured.failure.set("the host ended while it wrote a measurement");
  if (const std::string failure = measured.failure.get(); !failure.empty()) {
    tell(device_, failure);
    throw DeviceFault(device_.name() + ": " + failure);
  }
  return measured;
}

std::string HostLink::who() const {
  return "the host of " + device_.name() + " (process " + std::to_string(process_) + ")";
}

std::string HostLink::hangs(const std::string& call) const {
  return who() + " hangs: it did not return from " + call + " in time, and was killed";
}

void HostLink::require_done(const HostAnswer& answer) {
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

bool HostLink::await_end(std::uint32_t number, double seconds) {
  const double limit = monotonic_time() + seconds;
  while (true) {
    const std::uint32_t done = memory_->done;
    if (has_come(done, number)) return true;
    if (is_lost_) refuse();
    const double left = limit - monotonic_time();
    if (left <= 0.0) return false;
    await_change(memory_->done, done, std::min(left, kLook));
  }
}

void HostLink::lose(const std::string& reason, bool kills) {
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
  has_told_of_loss_ = true;
}

void HostLink::settle() const {
  while (is_lost_ && !has_told_of_loss_) std::this_thread::sleep_for(std::chrono::milliseconds(1));
}

void HostLink::look_after() {
  pthread_setname_np(pthread_self(), "rcs host link");
  sigset_t all;
  sigfillset(&all);
  pthread_sigmask(SIG_BLOCK, &all, nullptr);  // signals are for the threads of the program
  Overdue overdue;
  while (!ends_ && !is_lost_) {
    memory_->sign_of_program = host_clock();
    const std::uint32_t now = memory_->changes_of_fault;
    await_change(memory_->changes_of_fault, is_recovering_ ? now : seen_.load(), kLook);  // told after `recover`
    if (ends_) return;
    const bool has_ended = is_gone(socket_, process_file_);
    if (const std::uint32_t closing = closing_; has_ended && closing != 0 && has_come(memory_->done, closing)) return;
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

void HostLink::tell_of_fault() {
  const std::uint32_t now = memory_->changes_of_fault;
  if (now == seen_ || is_recovering_) return;
  HostText<512> fault{};
  if (!memory_->fault.read(fault)) return;
  seen_ = now;
  if (fault.characters[0] != '\0') tell(device_, fault.get());
}

void HostLink::tell_of_late_refusal() {
  const std::uint32_t late = late_;
  HostAnswer refusal{};
  if (late == 0 || !memory_->refusal.read(refusal)) return;
  if (refusal.number == 0 || !has_come(late, refusal.number)) return;
  if (told_.exchange(refusal.number) == refusal.number || is_recovering_) return;
  // The host holds the device, which may be on its way; nobody waits for it here, for this thread shows that we run.
  ++memory_->stops;
  ++memory_->hold_asked;
  wake_all(memory_->hold_asked);
  tell(device_, "a command was refused late: " + refusal.text.get());
}

}  // namespace rcs
