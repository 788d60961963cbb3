// The table of contents of `rcs._core`. Each topic is bound in a file of its own.
#include <mujoco/mujoco.h>
#include <nanobind/nanobind.h>

#include <exception>
#include <string>

#include "overrides.hpp"

void bind_pose(nb::module_& m);
void bind_pose_arrays(nb::module_& m);
void bind_device(nb::module_& m);
void bind_arm(nb::module_& m);
void bind_streamed_arm(nb::module_& m);
void bind_hand(nb::module_& m);
void bind_camera(nb::module_& m);
void bind_hosted(nb::module_& m);
void bind_kinematics(nb::module_& m);
void bind_collision_checker(nb::module_& m);
void bind_line_profile(nb::module_& m);
void bind_callback(nb::module_& m);
void bind_measurement(nb::module_& m);
void bind_world(nb::module_& m);
void bind_sim_devices(nb::module_& m);
void bind_render(nb::module_& m);
void bind_pixels(nb::module_& m);
void bind_sensor_noise(nb::module_& m);
void bind_rows(nb::module_& m);

namespace {

/// Whether an exception of Python is the cause of an error, also of its cause; it is then the present one.
bool restore_cause(const std::exception& error) {
  try {
    std::rethrow_if_nested(error);
  } catch (nb::python_error& cause) {
    cause.restore();
    return true;
  } catch (const std::exception& cause) {  // from C++: its message is in that of `error`
    return restore_cause(cause);
  }
  return false;
}

void raise_as(const char* name, const std::exception& error) {
  const nb::object type = error_class(name);
  if (restore_cause(error)) return nb::chain_error(type, "%s", error.what());
  PyErr_SetString(type.ptr(), error.what());
}

}  // namespace

NB_MODULE(_core, m) {
  m.doc() = "The C++ core of the Robot Control Stack.";
  if (mj_version() != mjVERSION_HEADER)
    throw std::runtime_error("rcs was built for MuJoCo " + std::to_string(mjVERSION_HEADER) + " and found " +
                             std::to_string(mj_version()) + "; reinstall robot-control-stack");
  nb::register_exception_translator([](const std::exception_ptr& p, void*) {
    try {
      std::rethrow_exception(p);
    } catch (const rcs::InvalidCommand& error) {
      raise_as("InvalidAction", error);
    } catch (const rcs::InvalidSetup& error) {
      raise_as("InvalidSetup", error);
    } catch (const rcs::WrongOrder& error) {
      raise_as("WrongOrder", error);
    } catch (const rcs::DeviceFault& error) {
      raise_as("DeviceFault", error);
    } catch (const rcs::SimulationError& error) {
      raise_as("SimulationError", error);
    }
  });
  // A callback that refers to its world keeps it alive to the end of the program: common, harmless, and not worth a
  // page of text.
  nb::set_leak_warnings(false);
  bind_pose(m);
  bind_pose_arrays(m);
  bind_device(m);
  bind_arm(m);
  bind_hand(m);
  bind_camera(m);
  bind_hosted(m);
  bind_kinematics(m);
  bind_streamed_arm(m);
  bind_collision_checker(m);
  bind_line_profile(m);
  bind_callback(m);
  bind_measurement(m);
  bind_world(m);
  bind_sim_devices(m);
  bind_render(m);
  bind_pixels(m);
  bind_sensor_noise(m);
  bind_rows(m);
}
