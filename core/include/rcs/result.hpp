// Outcomes of calls when nothing is wrong with the program: outcomes are values, errors are exceptions.
#pragma once

#include <cstdint>
#include <stdexcept>
#include <string>

#include "rcs/interface.hpp"

namespace rcs {

/// Why a control step of a simulation ended.
enum class StepEnd : std::uint8_t {
  period,       ///< asynchronous: one control period has passed
  converged,    ///< synchronous: every convergence callback agreed
  interrupted,  ///< a callback interrupted the step
  limit,        ///< synchronous: the substep limit came before convergence
  failed,       ///< a state or control that is not a finite number, or an exception
  fault,        ///< a robot went into its fault state, as after a collision
};

/// The result of inverse kinematics.
enum class IkStatus : std::uint8_t {
  ok,          ///< the target is reached within the tolerances
  clamped,     ///< the target is farther away than allowed, the answer is the allowed step towards it
  infeasible,  ///< no solution found inside the joint limits; the answer is the start, so nothing moves
  nearest,     ///< with best effort: no solution near the start, the answer is the nearest pose inside the joint limits
};

/// A command that a device may not execute: wrong size, not finite, or outside its limits.
struct RCS_API InvalidCommand : std::invalid_argument {
  using std::invalid_argument::invalid_argument;
};

/// A setup, an option or an argument that does not make sense.
struct RCS_API InvalidSetup : std::invalid_argument {
  using std::invalid_argument::invalid_argument;
};

/// A call at a time when it has no meaning, such as a command before `open`.
struct RCS_API WrongOrder : std::logic_error {
  using std::logic_error::logic_error;
};

/// MuJoCo stopped, or dropped contacts, because it ran out of memory or met a model that it cannot compute.
struct RCS_API SimulationError : std::runtime_error {
  using std::runtime_error::runtime_error;
};

/// A device is in its fault state; `recover` clears it.
struct RCS_API DeviceFault : std::runtime_error {
  using std::runtime_error::runtime_error;
};

}  // namespace rcs
