// A streamed arm in C++ outside of the project: its joints are where the points say, and it notes when they came.
#include <nanobind/nanobind.h>
#include <nanobind/stl/pair.h>
#include <nanobind/stl/vector.h>

#include <atomic>
#include <mutex>
#include <utility>
#include <vector>

#include "rcs/streamed_arm.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace {

class ServoArm final : public rcs::StreamedArm {
 public:
  ServoArm(rcs::ArmLimits limits, rcs::StreamOptions options)
      : StreamedArm("servo arm", std::move(limits), std::move(options)) {
    for (int i = 0; i < dof(); ++i)
      joints_.push_back((this->limits().joint_lower[i] + this->limits().joint_upper[i]) / 2);
  }
  ~ServoArm() override { close(); }

  /// When points were written [s], and the acceleration of the first joint in them [rad/s²].
  std::vector<std::pair<double, double>> log() {
    const std::lock_guard lock(mutex_);
    return log_;
  }
  std::atomic<bool> has_link = true;

 protected:
  void read(rcs::ArmState& state) override {
    if (!has_link) throw std::runtime_error("no answer from the controller");
    state.joints = joints_;
    state.joint_velocities.assign(joints_.size(), 0.0);
  }
  void write(const rcs::StreamPoint& point) override {
    joints_ = point.position;
    const std::lock_guard lock(mutex_);
    log_.emplace_back(rcs::monotonic_time(), point.acceleration[0]);
  }
  void stop() override {}

 private:
  std::vector<double> joints_;
  std::mutex mutex_;
  std::vector<std::pair<double, double>> log_;
};

}  // namespace

NB_MODULE(servo_arm, m) {
  rcs::require_interface();
  nb::module_::import_("rcs.devices");
  nb::set_leak_warnings(false);  // as in ramp_arm
  nb::class_<ServoArm, rcs::StreamedArm>(m, "ServoArm")
      .def(nb::init<rcs::ArmLimits, rcs::StreamOptions>(), "limits"_a, "options"_a = rcs::StreamOptions())
      .def("log", &ServoArm::log)
      .def("lose_link", [](ServoArm& arm) { arm.has_link = false; });
}
