// Devices that run in a process of their own: HostedArm and its kin for the program, HostDesk for the host.
#include <nanobind/nanobind.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include <tuple>

#include "clamped.hpp"
#include "overrides.hpp"
#include "rcs/host_desk.hpp"
#include "rcs/hosted.hpp"

using namespace nb::literals;

namespace {

/// Python's function that connects: called with the GIL, and let go of with it.
rcs::HostLine::Connect to_connect(nb::callable connect) {
  const auto held = std::shared_ptr<nb::callable>(new nb::callable(std::move(connect)), [](nb::callable* object) {
    const HeldGil gil;
    delete object;
  });
  return [held] {
    const HeldGil gil;
    const nb::object answer = call_python([&] { return (*held)(); });
    return rcs::HostConnection{nb::cast<int>(answer[0]), nb::cast<int>(answer[1]), nb::cast<int>(answer[2])};
  };
}

/// The same, with what `connect` raises.
template <typename Hosted>
struct Connected final : Hosted {
  using Hosted::Hosted;
  std::optional<std::string> words_of(const std::exception& error) const override {
    const auto* raised = dynamic_cast<const nb::python_error*>(&error);
    return raised ? words_of_python(*raised) : Hosted::words_of(error);
  }
};

#define RCS_HOSTED_INIT(base)                                                      \
  "def __init__(self, like: " base                                                 \
  ", connect: collections.abc.Callable[[], tuple[int, int, int]], answer: float) " \
  "-> None"

template <typename Hosted, typename Base>
nb::class_<Hosted, Base> bind(nb::module_& m, const char* name, const char* doc, const char* signature) {
  static_assert(sizeof(Connected<Hosted>) == sizeof(Hosted));
  return nb::class_<Hosted, Base>(m, name, doc)
      .def(
          "__init__",
          [](Hosted* self, const Base& like, nb::callable connect, double answer) {
            new (self) Connected<Hosted>(like, to_connect(std::move(connect)), answer);
          },
          "like"_a, "connect"_a, "answer"_a, nb::sig(signature),
          "Be as `like`, a device of the driver that is never opened.\n\n`connect` starts a host where needed, opens "
          "the "
          "device there, and returns a file of shared memory, one of a socket, and\nthe number of the host's process. "
          "`answer` is how long the host may take to hold [s].")
      .def_prop_ro("host", &Hosted::host, "The number of the process of the host, or 0 where there is none.");
}

}  // namespace

void bind_hosted(nb::module_& m) {
  using rcs::HostCall, rcs::HostDesk, rcs::HostedArm, rcs::HostedGripper, rcs::HostedHand, rcs::HostOutcome,
      rcs::HostRequest;
  bind<HostedArm, rcs::Arm>(m, "HostedArm", "An arm whose driver runs in a process of its own.", RCS_HOSTED_INIT("Arm"))
      .def_prop_ro("is_streamed", &HostedArm::is_streamed,
                   "Whether it is a `StreamedArm` there. Only such an arm has `period` and `clamped`.")
      .def_prop_rw("period", &HostedArm::period, &HostedArm::set_period,
                   "Time between commands [s], for which they are planned. Set it before the first one.")
      .def(
          "clamped", [](const HostedArm& arm) { return counts_of(arm.clamped()); },
          "How many commands since `open` asked for more than is allowed, by what was too much, as last measured.");
  bind<HostedGripper, rcs::Gripper>(m, "HostedGripper", "A gripper whose driver runs in a process of its own.",
                                    RCS_HOSTED_INIT("Gripper"));
  bind<HostedHand, rcs::Hand>(m, "HostedHand", "A hand whose driver runs in a process of its own.",
                              RCS_HOSTED_INIT("Hand"));

  nb::enum_<HostCall>(m, "HostCall", "Requests of a program to the host of a device.")
      .value("joints", HostCall::joints)
      .value("pose", HostCall::pose)
      .value("twist", HostCall::twist)
      .value("velocities", HostCall::velocities)
      .value("torques", HostCall::torques)
      .value("opening", HostCall::opening)
      .value("has_arrived", HostCall::has_arrived)
      .value("guide", HostCall::guide)
      .value("recover", HostCall::recover)
      .value("close", HostCall::close);
  nb::enum_<HostOutcome>(m, "HostOutcome", "How a call ended in the host.")
      .value("done", HostOutcome::done)
      .value("invalid", HostOutcome::invalid)
      .value("wrong_order", HostOutcome::wrong_order)
      .value("fault", HostOutcome::fault);
  nb::class_<HostRequest>(m, "HostRequest", "One call that the program asks for.")
      .def_ro("call", &HostRequest::call)
      .def_prop_ro(
          "values", [](const HostRequest& request) { return to_array(request.values); }, nb::rv_policy::move)
      .def_ro("valid_for", &HostRequest::valid_for, "Remaining time of a command [s].")
      .def_ro("force", &HostRequest::force, "Grasping force [N], or None.")
      .def_ro("period", &HostRequest::period, "Time between commands to a streamed arm [s]; 0 for the usual one.")
      .def_ro("is_void", &HostRequest::is_void, "Whether the device was held after the program asked.");
  nb::class_<HostDesk>(m, "HostDesk",
                       "Where one device of a host is served: requests of the program come in, measurements and "
                       "answers go out.\n\nA thread holds the device when the program says so, ends or stands still.")
      .def(nb::init<int, int, int, rcs::Device&>(), nb::keep_alive<1, 5>(), "memory"_a, "socket"_a, "program"_a,
           "device"_a, "`program` is the number of its process; the files stay those of the caller.")
      .def_prop_ro("is_used", &HostDesk::is_used, "Whether the program is still there.")
      .def("promise", &HostDesk::promise, "under_way"_a, "seconds"_a,
           "Say what is done from now on, and that there is a sign after `seconds` at the latest.")
      .def("next", &HostDesk::next, WithoutGil(), "seconds"_a,
           "The next request, or None after `seconds` or when the program has ended.")
      .def("answer", &HostDesk::answer, WithoutGil(), "request"_a, "outcome"_a, "text"_a = "", "flag"_a = false,
           "Report how a request ended. If the device was held meanwhile, it is held again first.")
      .def("show", nb::overload_cast<const rcs::ArmState&>(&HostDesk::show), "state"_a, "Hand out a measurement.")
      .def("show", nb::overload_cast<const rcs::GripperState&>(&HostDesk::show), "state"_a)
      .def("show", nb::overload_cast<const rcs::HandState&>(&HostDesk::show), "state"_a)
      .def("show_failure", &HostDesk::show_failure, "reason"_a, "Say why there is no newer measurement.");
  m.attr("HOST_MEMORY") = rcs::host_memory_size();
  m.attr("INTERFACE_VERSION") = rcs::kInterfaceVersion;
}
