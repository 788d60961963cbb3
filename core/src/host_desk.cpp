#include "rcs/host_desk.hpp"

#include <pthread.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <csignal>
#include <exception>
#include <mutex>

#include "host_memory.hpp"

namespace rcs {

namespace {

/// How often the program is looked after [s].
constexpr double kLook = 0.01;
/// How long a host may take to let go of its devices after its program has ended [s].
constexpr unsigned kLettingGo = 5;

// Desks that let go of their devices, of the whole process. If one of them takes too long, the process ends.
std::mutex letting_go;
int desks_letting_go = 0;

void count_letting_go(int change) {
  const std::lock_guard lock(letting_go);
  desks_letting_go += change;
  if (change > 0 || desks_letting_go == 0) alarm(desks_letting_go == 0 ? 0 : kLettingGo);
}

// The last line of a message: that of an exception from Python begins with its whole traceback.
std::string last_line(std::string text) {
  while (text.ends_with('\n')) text.pop_back();
  return text.starts_with("Traceback ") ? text.substr(text.rfind('\n') + 1) : text;
}

}  // namespace

HostDesk::HostDesk(int memory, int socket, int program, Device& device)
    : device_(device),
      memory_(map_host_memory(memory)),
      socket_(socket),
      program_(program),
      process_file_(open_process(program)) {
  promise("open", 1.0);
  watch_ = std::thread([this] { watch(); });
}

HostDesk::~HostDesk() {
  ends_ = true;
  wake_all(memory_->hold_asked);
  watch_.join();
  tell_fault();
  if (!is_used_) count_letting_go(-1);
  if (process_file_ >= 0) close(process_file_);
  unmap_host_memory(memory_);
}

void HostDesk::promise(const char* under_way, double seconds) {
  HostText<64> text{};
  text.set(under_way);
  memory_->under_way.write(text);
  memory_->next_sign = host_clock() + static_cast<std::int64_t>(seconds * 1e9);
}

std::optional<HostRequest> HostDesk::next(double seconds) {
  const double limit = monotonic_time() + seconds;
  while (is_used_ && memory_->asked == last_) {
    const double left = limit - monotonic_time();
    if (left <= 0.0) return {};
    await_change(memory_->asked, last_, left);
  }
  HostAsked asked{};
  if (!is_used_ || !memory_->request.read(asked)) return {};
  last_ = asked.number;
  const std::uint32_t stops = asked.stops;
  HostRequest request{asked.number, asked.call, {}, kForever, {}, asked.period, stops, stops != memory_->stops};
  const auto count = std::clamp<std::int32_t>(asked.count, 0, kHostValues);
  request.values.assign(asked.values.begin(), asked.values.begin() + count);
  if (!std::isnan(asked.force)) request.force = asked.force;
  if (asked.valid_until != INT64_MAX) request.valid_for = 1e-9 * static_cast<double>(asked.valid_until - host_clock());
  return request;
}

void HostDesk::answer(const HostRequest& request, HostOutcome outcome, const std::string& text, bool flag) {
  if (!request.is_void && request.stops != memory_->stops && device_.is_open()) {
    try {
      device_.hold();  // `hold` was called while this was under way
    } catch (const std::exception& error) {
      device_.set_fault("holding failed: " + last_line(error.what()));
    }
  }
  tell_fault();
  HostAnswer answer{request.number, outcome, flag ? 1 : 0, {}};
  answer.text.set(text);
  memory_->answer.write(answer);
  if (outcome != HostOutcome::done) memory_->refusal.write(answer);
  memory_->done = request.number;
  wake_all(memory_->done);
}

void HostDesk::show(const ArmState& state) {
  HostMeasured measured{};
  const std::array<const std::vector<double>*, 5> all{&state.joints, &state.joint_velocities, &state.commanded_joints,
                                                      &state.efforts, &state.wrench};
  for (std::size_t i = 0; i < all.size(); ++i) {
    measured.counts[i] = static_cast<std::int32_t>(std::min(all[i]->size(), kHostValues));
    std::copy_n(all[i]->begin(), measured.counts[i], measured.values[i].begin());
  }
  measured.time = state.time;
  measured.device_time = state.device_time;
  measured.mode.set(state.mode);
  if (const auto* streamed = dynamic_cast<const StreamedArm*>(&device_)) measured.clamped = streamed->clamped();
  memory_->measured.write(measured);
}

void HostDesk::show(const GripperState& state) {
  HostMeasured measured{};
  measured.opening = state.opening;
  measured.force = state.force;
  measured.time = state.time;
  measured.device_time = state.device_time;
  memory_->measured.write(measured);
}

void HostDesk::show(const HandState& state) {
  HostMeasured measured{};
  measured.counts[0] = static_cast<std::int32_t>(std::min(state.joints.size(), kHostValues));
  std::copy_n(state.joints.begin(), measured.counts[0], measured.values[0].begin());
  measured.time = state.time;
  measured.device_time = state.device_time;
  memory_->measured.write(measured);
}

void HostDesk::show_failure(const std::string& reason) {
  HostMeasured measured{};
  measured.failure.set(reason);
  memory_->measured.write(measured);
}

void HostDesk::watch() {
  pthread_setname_np(pthread_self(), "rcs host desk");
  sigset_t all;
  sigfillset(&all);
  pthread_sigmask(SIG_BLOCK, &all, nullptr);  // signals are for the main thread of the host
  std::uint32_t seen = 0;
  Overdue overdue;
  while (!ends_) {
    await_change(memory_->hold_asked, seen, kLook);
    if (ends_) return;
    if (const std::uint32_t now = memory_->hold_asked; now != seen) {
      seen = now;
      HostText<512> failure{};
      try {
        device_.hold();
      } catch (const std::exception& error) {
        failure.set(last_line(error.what()));
      }
      tell_fault();
      memory_->hold_failure.write(failure);
      memory_->held = seen;
      wake_all(memory_->held);
    }
    tell_fault();
    if (is_gone(socket_, process_file_)) {
      count_letting_go(1);
      device_.set_fault("its program (process " + std::to_string(program_) + ") has ended");
      is_used_ = false;
      wake_all(memory_->asked);
      return;
    }
    const std::int64_t sign = memory_->sign_of_program;
    const bool is_silent = overdue.look(sign == 0 ? 0 : sign + static_cast<std::int64_t>(kSilence * 1e9));
    if (is_silent && !is_silent_)
      device_.set_fault("its program (process " + std::to_string(program_) + ") stands still, as by Ctrl-Z");
    is_silent_ = is_silent;
  }
}

void HostDesk::tell_fault() {
  const std::lock_guard lock(fault_mutex_);
  const std::string fault = device_.fault();
  if (fault == told_fault_) return;
  told_fault_ = fault;
  HostText<512> text{};
  text.set(fault);
  memory_->fault.write(text);
  ++memory_->changes_of_fault;
  wake_all(memory_->changes_of_fault);
}

}  // namespace rcs
