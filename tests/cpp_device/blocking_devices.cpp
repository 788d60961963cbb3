// An arm and a camera in C++ whose calls wait until another thread lets them go, as calls of hardware wait for a
// network.
#include <nanobind/nanobind.h>
#include <nanobind/stl/string.h>

#include <chrono>
#include <condition_variable>
#include <mutex>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "rcs/arm.hpp"
#include "rcs/camera.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace {

/// Where a call of a device waits, at most two seconds.
class Gate {
 public:
  void shut() { set(false); }
  void let_go() { set(true); }
  void wait() {
    std::unique_lock lock(mutex_);
    was_let_go_ = condition_.wait_for(lock, std::chrono::seconds(2), [this] { return is_open_; });
  }
  /// Whether the last call was let go, and did not wait to the end.
  bool was_let_go() const { return was_let_go_; }

 private:
  void set(bool is_open) {
    const std::lock_guard lock(mutex_);
    is_open_ = is_open;
    condition_.notify_all();
  }

  std::mutex mutex_;
  std::condition_variable condition_;
  bool is_open_ = true;
  bool was_let_go_ = true;
};

class BlockingArm final : public rcs::Arm {
 public:
  explicit BlockingArm(rcs::ArmLimits limits) : Arm("blocking arm", std::move(limits)) {}
  Gate gate;
  /// Whether a command came after the last stop.
  bool is_moving = false;

 protected:
  void do_open() override { gate.wait(); }
  rcs::ArmState do_state() override {
    gate.wait();
    const std::vector<double> zeros(static_cast<std::size_t>(dof()), 0.0);
    return {zeros, zeros};
  }
  void do_command_joints(std::span<const double>) override {
    gate.wait();
    is_moving = true;
  }
  bool do_has_arrived() override {
    gate.wait();
    return true;
  }
  void do_hold() override { is_moving = false; }
  void do_recover() override { gate.wait(); }
  void do_close() override { gate.wait(); }
};

class BlockingCamera final : public rcs::Camera {
 public:
  BlockingCamera() : Camera("blocking camera", {4, 2, 30.0, false}) {}
  Gate gate;

 protected:
  void do_open() override { gate.wait(); }
  rcs::Frame do_read() override {
    gate.wait();
    return {4, 2, rcs::share(std::vector<std::uint8_t>(4 * 2 * 3)), nullptr, 0};
  }
  void do_close() override { gate.wait(); }
};

}  // namespace

NB_MODULE(blocking_devices, m) {
  nb::module_::import_("rcs.devices");  // registers the types that this module shares
  nb::set_leak_warnings(false);         // as in ramp_arm
  nb::class_<Gate>(m, "Gate")
      .def("shut", &Gate::shut)
      .def("let_go", &Gate::let_go)
      .def_prop_ro("was_let_go", &Gate::was_let_go);
  nb::class_<BlockingArm, rcs::Arm>(m, "BlockingArm")
      .def(nb::init<rcs::ArmLimits>(), "limits"_a)
      .def_ro("gate", &BlockingArm::gate)
      .def_ro("is_moving", &BlockingArm::is_moving);
  nb::class_<BlockingCamera, rcs::Camera>(m, "BlockingCamera").def(nb::init<>()).def_ro("gate", &BlockingCamera::gate);
}
