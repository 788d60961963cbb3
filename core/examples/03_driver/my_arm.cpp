// An arm in C++ that `rcs.make` drives: the class, and the lines that hand it to Python. Python takes no part in the
// stream of points: a program that keeps the interpreter busy delays none.
#include <nanobind/nanobind.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include <atomic>
#include <cstddef>
#include <memory>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "rcs/streamed_arm.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace {

/// Stands for a vendor's library: a controller whose joints come to a target within some milliseconds.
class Connection {
 public:
  Connection(const std::string& address, std::vector<double> joints)
      : joints_(std::move(joints)), velocities_(joints_.size(), 0.0) {
    if (address.empty()) throw std::runtime_error("no controller without an address");
  }
  void enable(bool is_on) { is_enabled_ = is_on; }
  void send(const std::vector<double>& target, double period) {
    for (std::size_t i = 0; i < joints_.size() && is_enabled_; ++i) {
      velocities_[i] = 0.5 * (target[i] - joints_[i]) / period;
      joints_[i] += velocities_[i] * period;
    }
  }
  const std::vector<double>& joints() const { return joints_; }
  const std::vector<double>& velocities() const { return velocities_; }

 private:
  std::atomic<bool> is_enabled_ = false;     // `stop` may run on another thread
  std::vector<double> joints_, velocities_;  // rad, rad/s
};

class MyArm final : public rcs::StreamedArm {
 public:
  MyArm(std::string address, rcs::ArmLimits limits, std::vector<double> start)
      : StreamedArm("my arm at " + address, std::move(limits), {.rate = kRate, .missed_ticks = 500}),
        address_(std::move(address)),
        joints_(std::move(start)) {}
  ~MyArm() override { close(); }  // while the functions below are there

 protected:
  void connect() override { connection_ = std::make_unique<Connection>(address_, joints_); }
  void read(rcs::ArmState& state) override {
    state.joints = connection_->joints();
    state.joint_velocities = connection_->velocities();
  }
  void start() override { connection_->enable(true); }
  void write(const rcs::StreamPoint& point) override { connection_->send(point.position, 1.0 / kRate); }
  void stop() override {
    if (connection_) connection_->enable(false);
  }
  void disconnect() override {
    if (connection_) joints_ = connection_->joints();
    connection_.reset();
  }

 private:
  static constexpr double kRate = 250.0;  // Hz

  std::string address_;
  std::vector<double> joints_;  // rad, where it stands while nobody is connected
  std::unique_ptr<Connection> connection_;
};

}  // namespace

NB_MODULE(my_arm, m) {
  rcs::require_interface();             // refuses a library of another version than that of these headers
  nb::module_::import_("rcs.devices");  // has the class below which this one is
  nb::set_leak_warnings(false);         // nanobind's, of objects that live as long as the program
  nb::class_<MyArm, rcs::StreamedArm>(m, "MyArm")
      .def(nb::init<std::string, rcs::ArmLimits, std::vector<double>>(), "address"_a, "limits"_a, "start"_a);
}
