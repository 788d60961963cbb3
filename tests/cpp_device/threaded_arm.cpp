// An arm in C++ with a thread of its own, as drivers have that talk to a controller at its rate: the calls of the
// interface only exchange targets and measurements with it.
#include <nanobind/nanobind.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cmath>
#include <mutex>
#include <span>
#include <stdexcept>
#include <stop_token>
#include <thread>
#include <utility>
#include <vector>

#include "rcs/arm.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace {

constexpr std::chrono::milliseconds kPeriod{2};

class ThreadedArm final : public rcs::Arm {
 public:
  explicit ThreadedArm(rcs::ArmLimits limits) : Arm("threaded arm", std::move(limits), {rcs::CommandKind::velocities}) {
    for (int i = 0; i < dof(); ++i)
      measured_.joints.push_back((this->limits().joint_lower[i] + this->limits().joint_upper[i]) / 2);
    measured_.joint_velocities.assign(measured_.joints.size(), 0.0);
    measured_.commanded_joints = measured_.joints;
    speed_ = this->limits().joint_velocity;
  }
  ~ThreadedArm() override { close(); }

  /// Have every call fail as without a link; the arm stops by itself.
  void lose_link() {
    do_hold();
    has_link_ = false;
  }
  void restore_link() { has_link_ = true; }
  bool can_guide() const override { return true; }

 protected:
  void do_open() override {
    reach();
    thread_ = std::jthread([this](const std::stop_token& stop) { run(stop); });
  }
  rcs::ArmState do_state() override {
    reach();
    const std::lock_guard lock(mutex_);
    return measured_;
  }
  void do_command_joints(std::span<const double> joints) override {
    reach();
    const std::lock_guard lock(mutex_);
    measured_.commanded_joints.assign(joints.begin(), joints.end());
    speed_ = limits().joint_velocity;
  }
  void do_command_velocities(std::span<const double> velocities) override {
    const std::lock_guard lock(mutex_);
    for (std::size_t i = 0; i < velocities.size(); ++i) {
      measured_.commanded_joints[i] = velocities[i] < 0.0 ? limits().joint_lower[i] : limits().joint_upper[i];
      speed_[i] = std::abs(velocities[i]);
    }
  }
  bool do_has_arrived() override {
    reach();
    const std::lock_guard lock(mutex_);
    return measured_.joints == measured_.commanded_joints;
  }
  void do_hold() override {
    reach();
    const std::lock_guard lock(mutex_);
    measured_.commanded_joints = measured_.joints;
  }
  void do_recover() override { reach(); }
  void do_close() override { thread_ = {}; }

 private:
  void reach() const {
    if (!has_link_) throw std::runtime_error("the link is lost");
  }

  void run(const std::stop_token& stop) {
    const double period = std::chrono::duration<double>(kPeriod).count();
    while (!stop.stop_requested()) {
      std::this_thread::sleep_for(kPeriod);
      const std::lock_guard lock(mutex_);
      for (std::size_t i = 0; i < speed_.size(); ++i) {
        const double reach = speed_[i] * period;
        const double step = std::clamp(measured_.commanded_joints[i] - measured_.joints[i], -reach, reach);
        measured_.joints[i] = std::abs(step) < reach ? measured_.commanded_joints[i] : measured_.joints[i] + step;
        measured_.joint_velocities[i] = step / period;
      }
      measured_.time = rcs::monotonic_time();
    }
  }

  std::atomic<bool> has_link_ = true;
  std::mutex mutex_;
  rcs::ArmState measured_;     // its commanded joints are where the thread goes
  std::vector<double> speed_;  // rad/s
  std::jthread thread_;
};

}  // namespace

NB_MODULE(threaded_arm, m) {
  rcs::require_interface();
  nb::module_::import_("rcs.devices");
  nb::set_leak_warnings(false);  // as in ramp_arm
  nb::class_<ThreadedArm, rcs::Arm>(m, "ThreadedArm")
      .def(nb::init<rcs::ArmLimits>(), "limits"_a)
      .def("lose_link", &ThreadedArm::lose_link)
      .def("restore_link", &ThreadedArm::restore_link);
}
