// An arm in C++ outside of the project: every joint runs to its target at its largest velocity, on a clock that tests
// move by hand.
#include <nanobind/nanobind.h>
#include <nanobind/stl/string.h>

#include <algorithm>
#include <cmath>
#include <span>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "rcs/arm.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace {

class RampArm final : public rcs::Arm {
 public:
  RampArm(std::string name, rcs::ArmLimits limits) : Arm(std::move(name), std::move(limits)) {
    for (int i = 0; i < dof(); ++i)
      joints_.push_back((this->limits().joint_lower[i] + this->limits().joint_upper[i]) / 2);
    velocities_.assign(joints_.size(), 0.0);
    target_ = joints_;
  }

  /// Let time pass.
  void advance(double seconds) {
    for (std::size_t i = 0; i < joints_.size(); ++i) {
      const double reach = limits().joint_velocity[i] * seconds;
      const double step = std::clamp(target_[i] - joints_[i], -reach, reach);
      joints_[i] += step;
      velocities_[i] = seconds > 0.0 ? step / seconds : 0.0;
    }
    time_ += seconds;
  }

  /// Have the device report what no device should: a joint too few, or a value that is not a number.
  void lose_joint() { joints_.pop_back(); }
  void measure_nan() { joints_.front() = std::nan(""); }
  /// Have every call fail as with a broken connection; the controller stops the arm.
  void disconnect() {
    do_hold();
    is_connected_ = false;
  }
  void reconnect() { is_connected_ = true; }

 protected:
  void do_open() override { reach(); }
  rcs::ArmState do_state() override {
    reach();
    return {joints_, velocities_, rcs::kNaN, time_};
  }
  void do_command_joints(std::span<const double> joints) override {
    reach();
    target_.assign(joints.begin(), joints.end());
  }
  bool do_has_arrived() override {
    reach();
    return target_ == joints_;
  }
  void do_hold() override {
    reach();
    target_ = joints_;
  }
  void do_recover() override { reach(); }

 private:
  void reach() const {
    if (!is_connected_) throw std::runtime_error("no answer from the controller");
  }

  std::vector<double> joints_;      // rad
  std::vector<double> velocities_;  // rad/s
  std::vector<double> target_;      // rad
  double time_ = 0.0;               // s
  bool is_connected_ = true;
};

}  // namespace

NB_MODULE(ramp_arm, m) {
  rcs::require_interface();
  nb::module_::import_("rcs.devices");  // registers the types that this module shares
  // pytest's fixtures hold this module and its arms to the very end of the process, which nanobind takes for a leak.
  nb::set_leak_warnings(false);
  nb::class_<RampArm, rcs::Arm>(m, "RampArm")
      .def(nb::init<std::string, rcs::ArmLimits>(), "name"_a, "limits"_a)
      .def("advance", &RampArm::advance, "seconds"_a)
      .def("lose_joint", &RampArm::lose_joint)
      .def("measure_nan", &RampArm::measure_nan)
      .def("disconnect", &RampArm::disconnect)
      .def("reconnect", &RampArm::reconnect);
}
