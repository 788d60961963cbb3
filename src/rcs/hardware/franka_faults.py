"""Messages for the errors of a Franka controller: the cause and the remedy."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from typing import Any, TypeVar

from rcs.errors import DeviceFault

T = TypeVar("T")

CONNECTING = 2.5
"""Timeout for a controller's first answer [s]."""
RECOVERING = 1.0
"""Timeout for becoming idle after a recovery [s]."""
STAYING = 0.1
"""Time for which an arm must stay idle to count as recovered [s]."""
RECOVERIES = 3
"""Most recoveries in one `recover`."""

_LATE = (
    "too many commands in a row were late or lost: use a separate cable to the control box and a real-time kernel, and "
    "end other programs (docs/franka.md)"
)
_FAST = "the motion was faster than the robot admits there: keep away from the ends of the joints' ranges"
_WORDS = {
    "joint_reflex": "something pushed against the arm: check what it touched",
    "cartesian_reflex": "something pushed against the tool: check what it touched",
    "communication_constraints_violation": _LATE,
    "joint_velocity_violation": _FAST,
    "cartesian_velocity_violation": _FAST,
    "joint_position_limits_violation": "a joint is at the end of its range: move the arm back by hand (Desk)",
    "self_collision_avoidance_violation": "the arm came too close to itself",
    "controller_torque_discontinuity": "the commanded torques jumped, as when commands are lost: " + _LATE,
    "tau_j_range_violation": "the commanded torques were too large: use less stiffness, or a lighter load",
    "power_limit_violation": "the motors drew too much power: move more slowly, or with a lighter load",
    "instability_detected": "the arm began to oscillate: use less stiffness, or more damping",
}
"""Messages by the error names in the vendor's documentation."""


def fault_of(state: Any, joints: Sequence[str], *, is_recoverable: bool = True) -> str:
    """Return a description of an arm's fault; empty without a fault.

    Args:
        state: franky's `RobotState`, or that of pylibfranka.
        joints: Names of the joints.
        is_recoverable: True to include faults that `recover` clears.
    """
    mode = mode_of(state)
    if mode == "UserStopped":
        return "the user stop is pressed (mode UserStopped): release it, then recover"
    if mode == "Other":
        return (
            "the joints are locked or the control interface is off (mode Other): unlock them and activate FCI in Desk"
        )
    if mode != "Reflex" or not is_recoverable:
        return ""
    names = names_of(state.current_errors) or names_of(state.last_motion_errors)
    pushed = [joint for joint, is_pushed in zip(joints, state.joint_collision, strict=True) if is_pushed]
    words = "; ".join(dict.fromkeys(_WORDS[name] for name in names if name in _WORDS))
    where = f" at {', '.join(pushed)}" if pushed else ""
    return (
        f"the robot stopped itself (mode Reflex) with {', '.join(names) or 'no error named'}{where}"
        f"{': ' + words if words else ''}; then recover"
    )


def make_idle(
    state: Callable[[], Any], recover: Callable[[], object], joints: Sequence[str], *, pause: float = 0.0
) -> None:
    """Recover an arm, which moves nothing, until it stays idle.

    The end of a connection that is found only now, such as that of a process that was killed, is a reflex of its own,
    which may come after the first recovery.

    Args:
        state: Returns the arm's present state, as for `fault_of`.
        recover: Recovers it.
        joints: Names of the joints.
        pause: Time between two states [s]; 0 if `state` waits for the next one.

    Raises:
        DeviceFault: A person must act first, or the arm does not stay idle after `RECOVERIES` recoveries.
    """
    for _ in range(RECOVERIES):
        if reason := fault_of(state(), joints, is_recoverable=False):
            raise DeviceFault(reason)
        recover()
        until = time.monotonic() + RECOVERING
        while mode_of(state()) != "Idle" and time.monotonic() < until:
            time.sleep(pause)
        until = time.monotonic() + STAYING
        while mode_of(state()) == "Idle":
            if time.monotonic() > until:
                return
            time.sleep(pause)
    last = state()
    raise DeviceFault(fault_of(last, joints) or f"the robot is in mode {mode_of(last)} after {RECOVERIES} recoveries")


def mode_of(state: Any) -> str:
    """Return the mode in franky's `RobotState`, such as `Idle`."""
    return str(state.robot_mode).rpartition(".")[2]


def names_of(errors: Any) -> list[str]:
    """Return the names of the errors that are set in franky's `Errors`."""
    return [name for name in dir(errors) if not name.startswith("_") and getattr(errors, name) is True]


def advice_for(address: str) -> str:
    """Return advice for a control box that does not answer."""
    return (
        f"Check the address ({address}), the cable to the control box and its lamp, that FCI is active in Desk "
        f"(https://{address}/desk), and that no other program is connected"
    )


def connected(make: Callable[[], T], address: str, what: str) -> T:
    """Connect to a controller within `CONNECTING` seconds.

    The library has no timeout: it never returns if the peer does not answer.

    Args:
        make: Opens and returns the connection.
        address: Address of the control box.
        what: Name of the device for messages, such as "the arm".

    Raises:
        DeviceFault: The connection was refused or timed out; the message says what to check.
    """
    try:
        return within(CONNECTING, make)
    except TimeoutError as err:
        raise DeviceFault(
            f"{what} at {address} has not answered within {CONNECTING:g} s. {advice_for(address)}"
        ) from err
    except Exception as err:  # the library's exceptions have no common base class
        text = str(err).strip()
        if "ncompatible" in f"{type(err).__name__} {text}":
            hint = (
                "Install the release of franky-control or pylibfranka for the robot's system version, or update the "
                "robot's system (docs/franka.md)"
            )
        else:
            hint = advice_for(address)
        raise DeviceFault(f"cannot connect to {what} at {address}: {text} {hint}") from err


def within(seconds: float, call: Callable[[], T]) -> T:
    """Run a call on a thread of its own and return its result.

    An exception of the call keeps nothing of it alive: a connection ends when the last reference to it does.

    Raises:
        TimeoutError: The call has not returned in time; its thread keeps running.
        Exception: Any exception of the call.
    """
    done: Future[T] = Future()
    threading.Thread(target=_run, args=(call, done), name="franka call", daemon=True).start()
    try:
        return done.result(seconds)
    finally:
        del call, done  # which the traceback would keep


def _run(call: Callable[[], T], done: Future[T]) -> None:
    try:
        done.set_result(call())
    except BaseException as err:  # noqa: BLE001 - raised again in the waiting thread
        done.set_exception(err.with_traceback(None))
