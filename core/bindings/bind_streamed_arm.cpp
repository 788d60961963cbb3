// StreamedArm: the thread that leads an arm from command to command, with a vendor's functions in Python.
#include <nanobind/nanobind.h>
#include <nanobind/stl/array.h>
#include <nanobind/stl/set.h>
#include <nanobind/stl/shared_ptr.h>

#include "clamped.hpp"
#include "overrides.hpp"
#include "rcs/kinematics.hpp"
#include "rcs/streamed_arm.hpp"

using namespace nb::literals;

namespace {

struct PyStreamedArm : PyCalls<rcs::StreamedArm> {
  using PyCalls::PyCalls;

  void connect() override { call_if_there("_open"); }
  void read(rcs::ArmState& state) override { state = call<rcs::ArmState>("_read", "an ArmState"); }
  void start() override { call_if_there("_start"); }
  void write(const rcs::StreamPoint& point) override { call<void>("_write", "None", point); }
  void write_other(rcs::CommandKind kind, std::span<const double> values) override {
    call<void>("_write_other", "None", kind, values);
  }
  bool brake_other() override { return call_or("_brake_other", "a bool", true); }
  void stop() override { call<void>("_stop", "None"); }
  void clear() override { call_if_there("_clear"); }
  void give_way() override { call_if_there("_guide"); }
  void disconnect() override { call_if_there("_close"); }
};

rcs::TcpBox make_box(std::array<double, 3> lower, std::array<double, 3> upper,
                     std::shared_ptr<rcs::Kinematics> kinematics) {
  return {lower, upper, [kinematics = std::move(kinematics)](std::span<const double> joints) {
            return kinematics->forward(joints).translation();
          }};
}

}  // namespace

void bind_streamed_arm(nb::module_& m) {
  using rcs::StreamedArm, rcs::StreamOptions, rcs::StreamPoint, rcs::TcpBox;
  nb::class_<StreamPoint> point(m, "StreamPoint", "Where the joints are to be at one tick.");
  def_array(point, "position", &StreamPoint::position, "Joint positions [rad].");
  def_array(point, "velocity", &StreamPoint::velocity, "Joint velocities [rad/s].");
  def_array(point, "acceleration", &StreamPoint::acceleration, "Joint accelerations [rad/s²].");

  nb::class_<TcpBox>(m, "TcpBox", "Where the TCP may be, in the frame of the base.")
      .def(
          "__init__",
          [](TcpBox* self, std::array<double, 3> lower, std::array<double, 3> upper,
             std::shared_ptr<rcs::Kinematics> kinematics) {
            new (self) TcpBox(make_box(lower, upper, std::move(kinematics)));
          },
          "lower"_a, "upper"_a, "kinematics"_a,
          "Bounds [m]. The kinematics are asked several times per tick: those that are written in Python make ticks "
          "late.");

  nb::class_<StreamOptions>(m, "StreamOptions", "How an arm is streamed to.")
      .def(
          "__init__",
          [](StreamOptions* self, double rate, double period, bool is_paced_by_read, double margin, double first_step,
             double tracking_error, double arrival, double silence, int missed_ticks, std::optional<TcpBox> box,
             std::set<rcs::CommandKind> more_commands) {
            new (self) StreamOptions{rate,
                                     period,
                                     is_paced_by_read,
                                     margin,
                                     first_step,
                                     tracking_error,
                                     arrival,
                                     silence,
                                     missed_ticks,
                                     std::move(box),
                                     std::move(more_commands)};
          },
          nb::kw_only(), "rate"_a = 1000.0, "period"_a = 1.0 / 30.0, "is_paced_by_read"_a = false, "margin"_a = 0.0,
          "first_step"_a = 0.2, "tracking_error"_a = 0.3, "arrival"_a = 0.01, "silence"_a = 0.25, "missed_ticks"_a = 20,
          "box"_a = nb::none(), "more_commands"_a = std::set<rcs::CommandKind>(),
          "Points per second, and the time between commands [s].\n\nWith `is_paced_by_read`, `_read` returns once per "
          "tick and is waited for. Targets keep the `margin` [rad] from the ends of\nthe joints' ranges; the first one "
          "is within `first_step` [rad] of the measured joints. A joint that is farther than\n`tracking_error` [rad] "
          "from where it is led, calls that do not return for longer than `silence` [s] and more than\n`missed_ticks` "
          "in a row are faults. A joint has arrived within `arrival` [rad]. `more_commands` are "
          "what the arm takes besides joints.")
      .def_ro("rate", &StreamOptions::rate)
      .def_ro("period", &StreamOptions::period)
      .def_ro("is_paced_by_read", &StreamOptions::is_paced_by_read)
      .def_ro("margin", &StreamOptions::margin)
      .def_ro("first_step", &StreamOptions::first_step)
      .def_ro("tracking_error", &StreamOptions::tracking_error)
      .def_ro("arrival", &StreamOptions::arrival)
      .def_ro("silence", &StreamOptions::silence)
      .def_ro("missed_ticks", &StreamOptions::missed_ticks);

  nb::class_<StreamedArm, rcs::Arm, PyStreamedArm>(
      m, "StreamedArm",
      "An arm that a thread leads from command to command, at the arm's rate, along the trajectory of a simulated one."
      "\n\nSubclasses override `_read`, `_write`, `_stop` and, where needed, `_open`, `_start`, `_clear`, `_guide` "
      "with "
      "`_can_guide`,\nand `_close`; users call what every `Arm` has. `open` connects and reads; the first command, "
      "which must be near the\nmeasured joints, starts the arm. From then on each tick writes a point, within the "
      "limits of position, speed,\nacceleration and jerk. A command whose time is over, `hold` and faults from outside "
      "brake the arm within these limits,\nand it is led where it stands. Errors of `_read` or `_write`, a joint "
      "that "
      "is not where it is led, and too many missed\nticks are faults that call `_stop` at once; after `recover`, the "
      "next command starts the arm again. An arm that names "
      "`more_commands` overrides\n`_write_other(kind, values)` and `_brake_other`; the controller keeps the limits "
      "then.\n\nAll of the vendor's functions run on the arm's thread but `_open`, "
      "`_close` "
      "and, while another one does not return, `_stop`.")
      .def(nb::init<std::string, rcs::ArmLimits, StreamOptions>(), "name"_a, "limits"_a, "options"_a = StreamOptions(),
           "Raises InvalidSetup where the limits lack acceleration or jerk, or an option makes no sense.")
      .def(
          "_start", [](StreamedArm&) {},
          "Switch on what follows points: the next one is where the arm is; nothing unless overridden.")
      .def(
          "_clear", [](StreamedArm&) {},
          "Leave the controller's fault state, without a motion; nothing unless overridden.")
      .def(
          "_brake_other", [](StreamedArm&) { return true; },
          "Send what brings the arm to rest from another command than joints, a tick at a time, and return whether it "
          "stands.")
      .def_prop_ro("options", &StreamedArm::options)
      .def_prop_rw("period", &StreamedArm::period, &StreamedArm::set_period,
                   "Time between commands [s], for which they are planned. Set it before the first one.")
      .def(
          "clamped", [](const StreamedArm& arm) { return counts_of(arm.clamped()); },
          "How many commands since `open` asked for more than is allowed, by what was too much.")
      .def_prop_ro("ticks", &StreamedArm::ticks, "Points written since `open`.")
      .def_prop_ro("missed_ticks", &StreamedArm::missed_ticks, "Ticks left out because the thread came too late.")
      .def_prop_ro("lapses", &StreamedArm::lapses, "Commands whose time was over before the next one.")
      .def_prop_ro("real_time_advice", &StreamedArm::real_time_advice,
                   "The obstacle to running the thread in real time and the line that mends it; may be empty.");
}
