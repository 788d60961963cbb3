"""A world: copies of a scene that are stepped together, one control step at a time.

A world on the user's own `MjModel` and `MjData` has arrays without a leading axis; a world of copies has arrays
(copies, ...). Code that indexes from the right (`qpos[..., 3]`) works on both. Stepping runs in C++ on MuJoCo's
thread pool without the GIL, and its result does not depend on the number of threads or copies.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from fractions import Fraction
from typing import Any, Literal, get_args

import mujoco
import numpy as np
from numpy.typing import NDArray
from rcs_data.options import require_whole

from rcs import _core
from rcs._core import StepCallback, StepEnd, StepView
from rcs.errors import InvalidSetup, SimulationError

Stepping = Literal["async", "sync", "realtime"]
"""How long a step lasts: one control period of simulated time, until converged, or one on the wall clock."""

Copies = NDArray[np.integer[Any]] | None
"""The copies that a call is for: distinct ids in any order, possibly none; None for all."""

StepFunction = Callable[[StepView], bool | None]
"""A function that sees a copy during a step; None counts as False."""
MOST = 2**31 - 1
"""Largest number of copies and of threads."""
LOWEST_FREQUENCY = 1e-6
"""Lowest control rate [Hz]: one step in eleven days."""
SHORTEST_PHYSICS_STEP = 1e-9
"""Shortest time step of the physics [s], the resolution of control periods."""
DIVERGENCE = (
    mujoco.mjtWarning.mjWARN_BADQPOS,
    mujoco.mjtWarning.mjWARN_BADQVEL,
    mujoco.mjtWarning.mjWARN_BADQACC,
    mujoco.mjtWarning.mjWARN_BADCTRL,
)
"""Warnings of MuJoCo that make a step fail."""


class World:
    """One scene, in one or many copies.

    The first world of a process turns MuJoCo's own profile, `MjData.timer`, off, which takes 3 % of the time;
    `mujoco.set_mjcb_time(None)` turns it on again.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        *,
        data: mujoco.MjData | None = None,
        copies: int | None = None,
        threads: int = 0,
        frequency: float = 30.0,
        stepping: Stepping = "async",
        max_substeps: int = 500,
    ) -> None:
        """Make a world on the user's data, or of `copies` copies.

        Args:
            model: The scene. A world of copies works on a copy of it.
            data: State of a world of one copy, changed in place; None for a new one.
            copies: Number of copies; None for one copy on `data`.
            threads: Threads for copies, 0 for one per CPU that this process may use.
            frequency: Control steps per second of simulated time [Hz].
            stepping: How long a step lasts.
            max_substeps: Limit of physics steps in a synchronous step, counted from when its motions are to end.

        Raises:
            InvalidSetup: A number or `stepping` is not valid, both `data` and `copies` are given, or the data are of
                another model.
        """
        if stepping not in get_args(Stepping):
            raise InvalidSetup(f"stepping is {stepping!r}; valid: {', '.join(map(repr, get_args(Stepping)))}.")
        if copies is not None and data is not None:
            raise InvalidSetup("Give data for one copy or copies for many, not both.")
        if copies is not None:
            require_whole("copies", copies, 1, MOST)
            require_whole("threads", threads, 0, MOST)
        period = control_period(frequency, model.opt.timestep)
        timing = (period.numerator, period.denominator, stepping == "sync", max_substeps)
        self.model = model
        self.frequency = frequency
        self.stepping: Stepping = stepping
        self.leading: tuple[int, ...] = () if copies is None else (int(copies),)
        """Leading shape of every array: () or (copies,)."""
        if copies is None:
            self.data = mujoco.MjData(model) if data is None else data
            self.core = _core.World.on_data(model, self.data, *timing)
            mujoco.mj_kinematics(model, self.data)
        else:
            self.data = None
            self.core = _core.World.of_copies(model, copies, threads, *timing)
        state = mujoco.mjtState
        self.qpos = self.core.component(state.mjSTATE_QPOS.value)
        """Live positions of all joints, (*leading, nq)."""
        self.qvel = self.core.component(state.mjSTATE_QVEL.value)
        """Live velocities of all joints, (*leading, nv)."""
        self.ctrl = self.core.component(state.mjSTATE_CTRL.value)
        """Live controls, (*leading, nu)."""
        self.userdata = self.core.component(state.mjSTATE_USERDATA.value) if model.nuserdata else None
        """Live user data, (*leading, nuserdata), with the motions of arms; None without any."""
        self.time = self.core.component(state.mjSTATE_TIME.value)[..., 0]
        """Live simulated time [s], (*leading,)."""
        self._nominal: dict[str, NDArray[Any]] = {}
        self._fields: dict[str, NDArray[Any]] = {}
        self._scratch: mujoco.MjData | None = None
        self._take_readouts()

    def _take_readouts(self) -> None:
        self.poses = self.core.poses
        """Live poses registered with `read_pose`, (*leading, readouts, 7): translation [m], quaternion xyzw."""
        self.xyzrpy = self.core.xyzrpy
        """The same poses as translation [m] and roll, pitch, yaw [rad], (*leading, readouts, 6)."""
        self.forces = self.core.forces
        """Live forces registered with `core.read_force`, (*leading, readouts) [N]."""
        self.openings = self.core.openings
        """Live openings registered with `core.read_opening`, (*leading, readouts), 0 … 1."""
        self.measurements = self.core.measurements
        """Live values registered with `core.measure`, (*leading, values)."""

    def close(self) -> None:
        """Drop the callbacks and end the threads; later calls raise WrongOrder, but closing twice is harmless.

        Arrays keep their last values. Threads end when no array of this world is left.
        """
        if not self.core.is_open:
            return
        self.core.close()
        self._fields.clear()
        # Copies of the arrays, since this world's would keep the threads alive.
        self.qpos, self.qvel, self.ctrl, self.time = (a.copy() for a in (self.qpos, self.qvel, self.ctrl, self.time))
        self.userdata = None if self.userdata is None else self.userdata.copy()

    @property
    def copies(self) -> int:
        """Number of copies."""
        return self.core.copies

    def converge_when(self, is_done: StepFunction) -> None:
        """End a synchronous step when this and all other such functions return True."""
        self.core.converge_when(Callback(is_done))

    def interrupt_when(self, is_reason: StepFunction) -> None:
        """End a synchronous step as soon as a function returns True; an asynchronous step only reports it in `ends`."""
        self.core.interrupt_when(Callback(is_reason))

    def on_period(self, function: StepFunction, period: float) -> None:
        """Call a function at a rate of simulated time, of every copy; True interrupts the step.

        Args:
            function: Gets the state of the copy, to look at and to write controls into.
            period: Time between two calls [s], a multiple of the time step of the physics.

        Raises:
            InvalidSetup: The period is no such multiple; the message has the nearest.
        """
        physics_step = self.model.opt.timestep
        steps = period / physics_step
        # The core refuses what is shorter or not finite.
        if 0.5 <= steps < math.inf and not math.isclose(steps, round(steps), rel_tol=1e-9):
            fewer = max(math.floor(steps), 1)
            nearest = " and ".join(f"{round(n * physics_step, 12)} s" for n in (fewer, fewer + 1))
            raise InvalidSetup(
                f"The period is {period} s; valid is a multiple of the physics' time step of {physics_step} s. The "
                f"nearest are {nearest}."
            )
        self.core.on_period(Callback(function), period)

    @property
    def ends(self) -> list[StepEnd]:
        """Reasons for the end of the last step, by copy."""
        return [StepEnd(int(end)) for end in self.core.ends]

    @property
    def substeps(self) -> NDArray[np.int32]:
        """How many steps of the physics the last step of each copy had, (copies,)."""
        return self.core.substeps

    def read_pose(self, body: str, frame: str = "world") -> int:
        """Register the pose of a body in the frame of another one; return its index in `poses`.

        It is valid at once; forces are 0 until the next step.

        Raises:
            KeyError: A body is not in the model.
        """
        index = self.core.read_body_pose(self.model.body(body).id, self.model.body(frame).id)
        self.refresh()
        return index

    @property
    def period(self) -> float:
        """Control period [s]."""
        return 1.0 / self.frequency

    def advance(self, copies: Copies = None) -> None:
        """Advance copies by one control step.

        Raises:
            InvalidSetup: The copies are not distinct ids of this world.
            SimulationError: MuJoCo failed or dropped contacts; the message names the copy.
            WrongOrder: The world is stepping already, in another thread or around a callback, or is closed.
        """
        self.core.advance(*_chosen(copies))

    def why_diverged(self) -> str:
        """Return MuJoCo's message on why the last step failed, for a world of one copy; empty if it did not."""
        if self.data is None:
            return ""
        warnings = [(kind.value, self.data.warning[kind.value]) for kind in DIVERGENCE]
        return " ".join(mujoco.mju_warningText(kind, stat.lastinfo) for kind, stat in warnings if stat.number)

    def reset(self, copies: Copies = None) -> None:
        """Reset copies to the initial state; call `refresh` after writing the state."""
        self.core.reset(*_chosen(copies))

    def refresh(self, copies: Copies = None) -> None:
        """Recompute the readouts (poses, forces) after writing the state, or after adding some to `core`."""
        self.core.refresh(*_chosen(copies))
        self._take_readouts()

    def save(self, copies: Copies = None) -> NDArray[np.float64]:
        """Return everything that decides the future of copies, and the readouts, (copies, values)."""
        chosen = range(self.copies) if copies is None else copies
        return np.reshape([self.core.save(int(copy)) for copy in chosen], (-1, self.core.save_size))

    def load(self, saved: NDArray[np.float64], copies: Copies = None) -> None:
        """Write back a result of `save`, (copies, values), also one of another world of the same kind.

        Raises:
            InvalidSetup: It has another size.
        """
        for copy, row in zip(range(self.copies) if copies is None else copies, saved, strict=True):
            self.core.load(row, int(copy))
        if self.data is not None and len(saved):
            self.refresh()  # what is drawn
            self.core.load(saved[0])  # the readouts were those of the last step

    def states(self) -> NDArray[np.float64]:
        """Return the whole integration state, (*leading, state_size); a live view for copies, a fresh array for one."""
        return self.core.states if self.leading else self.core.get_state(0)

    def vary(self, field: str) -> NDArray[Any]:
        """Return live, writable values of a field of `MjModel`, (*leading, *its shape), one per copy.

        Call `update_constants` after writing masses, inertias, sizes or places of bodies.

        Args:
            field: MuJoCo's name, such as `body_mass`.

        Raises:
            ValueError: The field cannot differ between copies.
        """
        self._fields.pop(field, None)
        values: NDArray[Any] = getattr(self.model, field)
        if self.leading:
            values = self.core.expand(field).reshape(*self.leading, *values.shape)
        if field not in self._nominal:
            self._nominal[field] = np.array(values[0] if self.leading else values)
        return values

    @property
    def varied(self) -> list[str]:
        """Names of the fields that have been given to `vary`."""
        return sorted(self._nominal)

    def nominal(self, field: str) -> NDArray[Any]:
        """Return the values that every copy had for a field before its first `vary`."""
        values = self._nominal.get(field)
        return getattr(self.model, field) if values is None else values

    def field(self, field: str) -> NDArray[Any]:
        """Return the present values of a field of `MjModel`, read-only, (*leading, *its shape)."""
        values = self._fields.get(field)
        if values is None:  # looking them up costs more than most resets use them for
            common: NDArray[Any] = getattr(self.model, field)
            shape = (*self.leading, *common.shape)
            own = self.core.expanded(field) if self.leading else None
            values = self._fields[field] = np.broadcast_to(common, shape) if own is None else own.reshape(shape)
        return values

    def update_constants(self, copies: Copies = None) -> None:
        """Recompute the constants derived from masses, inertias and sizes (`mj_setConst`)."""
        if not self.leading:
            if self._scratch is None:
                self._scratch = mujoco.MjData(self.model)
            try:
                mujoco.mj_setConst(self.model, self._scratch)
            except mujoco.FatalError as err:
                raise SimulationError(f"The constants of the model could not be computed: {err}") from err
        else:
            self.core.set_constants(*_chosen(copies))

    def geom_flags(self, names: Iterable[str]) -> NDArray[np.uint8]:
        """Return one flag per geom of the model that is 1 for the named ones.

        Raises:
            KeyError: A name is not in the model.
        """
        flags = np.zeros(self.model.ngeom, np.uint8)
        flags[[self.model.geom(name).id for name in names]] = 1
        return flags

    def subtree_flags(self, body: str) -> NDArray[np.uint8]:
        """Return flags per geom, then per flex: 1 for those of a body and everything attached to it.

        Raises:
            KeyError: The body is not in the model.
        """
        inside = self.subtree(body)
        return np.concatenate([inside[self.model.geom_bodyid], self.subtree_flexes(body)]).astype(np.uint8)

    def subtree_flexes(self, body: str) -> NDArray[np.bool_]:
        """Return for each flex of the model whether all of it belongs to a body and everything attached to it.

        Raises:
            KeyError: The body is not in the model.
        """
        inside, model = self.subtree(body), self.model
        flexes = np.zeros(model.nflex, np.bool_)
        for i in range(model.nflex):
            # Vertices that are interpolated between nodes have no bodies.
            part = "node" if model.flex_interp[i] else "vert"
            first = getattr(model, f"flex_{part}adr")[i]
            bodies = getattr(model, f"flex_{part}bodyid")[first : first + getattr(model, f"flex_{part}num")[i]]
            flexes[i] = inside[bodies].all()
        return flexes

    def subtree(self, body: str) -> NDArray[np.bool_]:
        """Return for each body of the model whether it is the named one or attached to it.

        Raises:
            KeyError: The body is not in the model.
        """
        root = self.model.body(body).id
        inside = np.zeros(self.model.nbody, np.bool_)
        inside[root] = True
        for i in range(root + 1, self.model.nbody):  # parents come before children
            inside[i] = inside[self.model.body_parentid[i]]
        return inside


def control_period(frequency: float, physics_step: float) -> Fraction:
    """Return the control period in physics steps as an exact ratio, so that the mean rate is exact.

    Args:
        frequency: Control steps per second [Hz].
        physics_step: Time step of the physics [s].

    Raises:
        InvalidSetup: The frequency is too low or higher than that of the physics, or the physics has no time step.
    """
    if not (math.isfinite(physics_step) and physics_step >= SHORTEST_PHYSICS_STEP):
        raise InvalidSetup(f"The model's time step is {physics_step} s; it must be at least {SHORTEST_PHYSICS_STEP} s.")
    if not (math.isfinite(frequency) and LOWEST_FREQUENCY <= frequency <= 1 / physics_step + 1e-9):
        raise InvalidSetup(
            f"frequency is {frequency} Hz; valid is from {LOWEST_FREQUENCY} Hz up to the physics' "
            f"{1 / physics_step:g} Hz."
        )
    return 1 / (Fraction(frequency).limit_denominator(10**6) * Fraction(physics_step).limit_denominator(10**9))


def _chosen(copies: Copies) -> tuple[NDArray[np.integer[Any]], ...]:
    """Return the arguments of a call of the core for some copies; none for all."""
    return () if copies is None else (copies,)


class Callback(StepCallback):
    """A Python function as a step callback."""

    def __init__(self, function: StepFunction) -> None:
        """Wrap `function(view) -> bool`; None counts as False."""
        super().__init__()
        self._function = function

    def call(self, view: StepView) -> bool:
        """Call the function."""
        return bool(self._function(view))
