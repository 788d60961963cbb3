"""One step of an environment, for a single one and for a batch: commands, time, observation, judgement, observers.

`Env` and `VecEnv` are its two faces. Arrays have the leading shape of the world, () or (copies,), and the same code
serves both: `array[where] = value` is for all copies with `where = ...`.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcs.envs.episode_random import EpisodeRandom
from rcs.envs.layers import CopyIndex
from rcs.envs.spaces import Observation
from rcs.envs.start import Start
from rcs.envs.step.clock import Clock
from rcs.envs.step.exclusive_calls import ExclusiveCalls
from rcs.envs.step.judge import FAULT, Judge, Step, row
from rcs.envs.step.observers import Observers
from rcs.envs.step.simulation import Simulation
from rcs.envs.step.stack import Nested, Stack, copied, for_all
from rcs.errors import DeviceFault, InvalidAction, Refused, WrongOrder
from rcs.sim.world import Copies

Approaches = Callable[[Stack, Clock, Callable[[], bool]], None]
"""Moves real robots slowly, until the last argument returns True because they must hold."""


class Engine:
    """Makes steps. Whatever goes wrong from the first command on, all devices hold."""

    def __init__(
        self, stack: Stack, clock: Clock, simulation: Simulation | None = None, *, max_episode_steps: int | None = None
    ) -> None:
        """Put the parts together; nothing moves and nothing is connected before `start`.

        Args:
            stack: Ports, layers and gates.
            clock: Lets time pass.
            simulation: A simulated world with its task; None for real devices alone.
            max_episode_steps: An episode is truncated after this many steps; None for no limit.
        """
        self.stack = stack
        self.simulation = simulation
        self.calls = ExclusiveCalls()
        self.leading: tuple[int, ...] = () if simulation is None else simulation.world.leading
        self.seeds = np.zeros(self.leading, np.int64)
        self.episodes = np.full(self.leading, -1, np.int64)
        """Number of the present episode since the seed was set."""
        self.is_over: NDArray[np.bool_] = np.zeros(self.leading, np.bool_)
        """Which copies' episodes are over."""
        self.is_open = True
        self.instruction = "" if simulation is None else simulation.task.instruction
        self._clock = clock
        self._judge = Judge(stack, clock, simulation, max_episode_steps)
        self.observers = Observers(stack, clock, simulation)
        self._resources: list[Callable[[], None]] = [] if simulation is None else [simulation.world.close]
        self.is_started = False
        """Whether episodes go on; if not, the next ones start in all copies."""
        self._broken_off_by = ""
        self._must_rebase = False
        self._is_commanded = False
        self._last_observation: Observation = {}

    def close_too(self, close: Callable[[], None]) -> None:
        """Have something closed after the observers."""
        self._resources.insert(0, close)

    # --- Episodes -----------------------------------------------------------------------------------------------------

    def start(
        self,
        copies: Copies = None,
        *,
        state: NDArray[np.float64] | None = None,
        start: Start | None = None,
        approach: Approaches | None = None,
    ) -> tuple[Observation, dict[str, Any]]:
        """Start the next episode of some copies, or of all when an error broke the last ones off.

        Args:
            copies: Which; None for all.
            state: Simulation state to start in, of a world of one copy.
            start: Places of robots and objects at the start, of a world of one copy.
            approach: Moves real robots to their start; None for leaving them where they are.
        """
        copies = copies if self.is_started else None
        info: dict[str, Any] = {}
        try:
            self._begin(copies)
            if self.simulation is not None and state is not None:
                self.simulation.world.core.set_state(state)
                self.simulation.world.refresh()
            if self.simulation is not None and start is not None:
                self.simulation.start_at(start)
            self.stack.open()
            self._require_no_fault()
            self._clock.reset()
            observation = self.observe_start(copies)
            self._require_no_fault()  # what was measured may be too old
            if approach is not None:
                self._approach(approach)
                self._clock.reset()
                observation = self.observe_start(copies)
            if self.simulation is not None:
                info = self.simulation.judge_start(copies)
            self._judge.note()
            self._must_rebase = False
            self.is_started, self._broken_off_by = True, ""
            info.update(time=self._judge.time(), instruction=np.full(self.leading, self.instruction, object))
            if again := self.stack.reconnections():
                info["reconnections"] = again  # those so far, which are not of this episode
            info = info if self.leading else row(info, ...)
            self.observers.on_reset(observation, info, self._seeds_of(copies))
        except BaseException as err:
            self._break_off(err, is_start=True)
            raise
        return observation, info

    def _approach(self, approach: Approaches) -> None:
        self._must_rebase = False
        approach(self.stack, self._clock, lambda: self._must_rebase)

    def _require_no_fault(self) -> None:
        if faults := self.stack.faults():
            raise DeviceFault(f"Devices are in their fault state: {_listed(faults)}. Clear it with env.recover().")

    def _begin(self, copies: Copies) -> None:
        where: CopyIndex = ... if copies is None else copies
        self.episodes[where] += 1
        self._make_arrays()
        self._judge.steps[where] = 0
        self.is_over[where] = False
        if self.simulation is not None:
            self.simulation.begin(EpisodeRandom(self.seeds[where], self.episodes[where]), copies)

    def observe_start(self, copies: Copies = None) -> Observation:
        """Observe the start of the episodes of some copies."""
        measured = self.stack.measure()
        self.stack.reset(measured, ... if copies is None else copies)
        self._last_observation = self.stack.lift(measured)
        return self._last_observation

    def require_running(self) -> None:
        """Check that a step may be made.

        Raises:
            WrongOrder: There was no reset, an error broke the episode off, or the environment is closed.
        """
        if not self.is_open:
            raise WrongOrder("step was called on a closed environment; make a new one.")
        if self._broken_off_by:
            raise WrongOrder(f"step was called after {self._broken_off_by} broke the episode off; call reset.")
        if not self.is_started:
            raise WrongOrder("step was called before the first reset; call reset.")

    # --- A step -------------------------------------------------------------------------------------------------------

    def step(self, action: Any, starting: NDArray[np.bool_] | None = None) -> Step:
        """Command all devices, let one control step pass, observe, judge, and notify the observers.

        Args:
            action: One array per key of the action space.
            starting: Copies that start their next episode in place of a step; None for none.

        Raises:
            InvalidAction: The action is not valid; no device saw it, unless a device refused it.
        """
        self._is_commanded = False
        try:
            return self._step(action, starting)
        except BaseException as err:
            if isinstance(err, InvalidAction) and not self._is_commanded:
                raise  # nothing was sent, nothing is remembered
            # Nothing goes on moving unwatched, also when a second Ctrl-C comes while the devices are made to hold.
            try:
                self._break_off(err)
            except KeyboardInterrupt:
                self._break_off(err)
                raise
            raise

    def _step(self, action: Any, starting: NDArray[np.bool_] | None) -> Step:
        measured: Nested | None = None
        refused: Refused | None = None
        ids = None if starting is None else np.flatnonzero(starting).astype(np.int32)
        observers = self.observers
        try:
            observers.after_hold = self._must_rebase
            self.rebase_if_held()
            mapped = self.stack.map(action)
            self._is_commanded = True
            try:
                self.stack.send(self.stack.admit(mapped))
            except Refused as err:
                refused = err
                self.stack.stay()
                self._must_rebase = True
            observers.command_time = self._clock.now()
            if self._must_rebase:
                observers.after_hold = True
                self.stack.hold()  # after a refusal, or a call of `hold` by another thread before the targets were sent
            if ids is None or starting is None:
                self._clock.advance(None, self._repeat)
            else:
                self._clock.advance(np.flatnonzero(~starting).astype(np.int32))
                self._begin(ids)
            measured = self.stack.measure()
            faults = self.stack.faults()
            if refused is not None and refused.ends_episode:
                faults["gate"] = str(refused)
        except DeviceFault as err:
            faults = self.stack.faults() or {"device": str(err)}
        if faults:
            self._hold_in_fault(faults)
            if measured is None:
                return self._end_without_row(faults)
        assert measured is not None, "without a fault, everything was measured"
        if ids is not None:
            self.stack.reset(measured, ids)
        observation = self.stack.lift(measured)
        collisions: dict[str, Any] | None = None
        failed = self._judge.failed(starting)
        diverged = self._judge.diverged(failed)
        if diverged is not None:
            observation = self._judge.without_diverged(observation, self._last_observation, diverged)
        if failed is not None:
            collisions = self._judge.collisions(failed)
            if any(port.can_fail for port in self.stack.ports):
                self._hold_in_fault(collisions)  # real devices; in simulation alone, no time passes any more
        step = self._judge.judge(observation, starting, failed, faults)
        self.is_over = step.terminated | step.truncated
        if not self.leading:
            step.info.update(observers.info())
        if refused is not None:
            step.info["refused"] = str(refused)
        if collisions is not None and not faults:
            step.info["faults"] = collisions
        self._last_observation = observation
        if starting is not None:
            observers.on_reset(observation, step.info, self._seeds_of(ids))
        observers.on_step(step, action, starting, diverged)
        if faults := step.info.get("faults", {}):
            self._end_observers(step, faults)
        return step

    def _repeat(self) -> None:
        """Send all devices their targets again, unless they must hold; another thread may decide that meanwhile."""
        if not self._must_rebase:
            self.stack.repeat()
            if self._must_rebase:
                self.stack.hold()

    def _seeds_of(self, started: Copies) -> dict[int, int | None]:
        """Return the seeds of copies that start an episode; None after the first: it depends on those before it."""
        copies = range(max(1, self.seeds.size)) if started is None else started
        seeds, episodes = self.seeds.reshape(-1), self.episodes.reshape(-1)
        return {int(copy): None if episodes[copy] else int(seeds[copy]) for copy in copies}

    # --- The whole state ----------------------------------------------------------------------------------------------

    def rebase_if_held(self) -> None:
        """Do now what the next step would do first."""
        if self._must_rebase:
            self._must_rebase = False  # before, for another thread may set it meanwhile
            self.stack.rebase()

    def counters(self) -> dict[str, Any]:
        """Return what is counted of the episodes, each (*leading,)."""
        return {"seeds": self.seeds, "episodes": self.episodes, "steps": self._judge.steps, "is_over": self.is_over}

    def set_counters(self, rows: Mapping[str, NDArray[Any]], copies: NDArray[np.int32]) -> None:
        """Set what is counted of some copies' episodes, (copies,) each."""
        where: Any = copies if self.leading else ...
        self._make_arrays()
        for name, counted in self.counters().items():
            counted[where] = rows[name] if self.leading else rows[name][0]

    def _make_arrays(self) -> None:
        """Make arrays, which can be written, of NumPy's numbers, which a single environment has for speed."""
        self._judge.steps, self.is_over = np.array(self._judge.steps), np.array(self.is_over)

    def go_on(self, copies: NDArray[np.int32]) -> Observation:
        """Observe after the state of some copies was set; their recordings end."""
        for copy in copies:
            self.observers.on_end("set_state", {"set_state": "A state was set."}, copy=int(copy))
        self._clock.reset()
        self._last_observation = self.stack.lift(self.stack.measure())
        if self.simulation is not None:
            self.simulation.evaluate()
        self._judge.note()
        return self._last_observation

    # --- When something goes wrong ------------------------------------------------------------------------------------

    def _end_observers(self, step: Step, faults: dict[str, Any]) -> None:
        """Tell the observers of an episode that ended in a fault; of a batch, those of the copies that did."""
        if not self.leading:
            self.observers.on_end(str(step.info["end"]), faults)
            return
        for copy in self._judge.collided(step):
            reasons = {name: str(own[copy]) for name, own in faults.items() if own[copy]}
            self.observers.on_end(FAULT, reasons, copy=int(copy))

    def _hold_in_fault(self, faults: dict[str, str]) -> None:
        """Have all devices hold; a refusal in the fault state is added to `faults`."""
        self._must_rebase = True
        try:
            self.stack.hold()
        except Exception as err:  # noqa: BLE001  the device that failed may refuse everything; the reason is passed on
            faults["hold"] = f"{type(err).__name__}: {err}"

    def _end_without_row(self, faults: dict[str, str]) -> Step:
        """End the episode in a step that not all devices took part in: observers see its end, but no step."""
        self.is_over = np.ones(self.leading, np.bool_)
        self.observers.on_end(FAULT, faults)
        try:
            observation = self.stack.lift(self.stack.measure())
        except DeviceFault:
            observation = copied(self._last_observation)
        info = {"time": self._judge.time(), "target": copied(self.stack.target), "end": FAULT, "faults": faults}
        if self._clock.is_real:
            info.update(self._judge.timing())
        return Step(
            observation=observation, reward=np.zeros(()), terminated=np.False_, truncated=np.True_, info=info
        )  # fmt: skip

    def _break_off(self, error: BaseException, *, is_start: bool = False) -> None:
        """Have all devices hold after an error in a step or a start, end the episodes, and notify the observers."""
        self._must_rebase = True
        calls: list[Callable[[], None]] = [self.stack.hold]
        # A device that refuses the action of a step is no reason to end the episode: the next one may be better.
        if (is_start or not isinstance(error, InvalidAction)) and self.is_started and not self._broken_off_by:
            if not self.is_over.all():
                calls.append(lambda: self.observers.on_end("exception", {type(error).__name__: str(error)}))
            self.is_started = False
            self._broken_off_by = type(error).__name__
        try:
            for_all(calls)
        except Exception as err:  # noqa: BLE001  the first error is the one to be raised
            error.add_note(f"While the devices were made to hold: {type(err).__name__}: {err}")

    def hold(self) -> None:
        """Make every device stay where it is; what follows counts from there. May be called from any thread."""
        self._must_rebase = True
        self.stack.hold()

    def rebase(self, robot: str | None = None) -> None:
        """Make what follows count from the measured state."""
        if not self.is_open or (self.episodes < 0).any():
            raise WrongOrder("rebase was called before the first reset, or on a closed environment.")
        self.stack.rebase(robot)

    def recover(self) -> None:
        """Clear the faults of all devices; nothing moves."""
        if not self.is_open:
            raise WrongOrder("recover was called on a closed environment; make a new one.")
        self._must_rebase = True
        self.stack.recover()

    def close(self, park: Approaches | None = None) -> None:
        """Let go of all devices, then of observers, pictures and the world, whatever fails. Closing twice is harmless.

        Called while another thread makes a step, it has all devices hold at once, and closes them after the step.

        Args:
            park: Moves real robots before; not where a step failed, a device is in fault or an error is under way.
        """
        if not self.is_open:
            return
        self.is_open = False
        held = [self.hold, self.calls.wait] if self.calls.is_of_another_thread else []
        try:
            if park is not None and self.is_started and not held and not self.stack.faults() and not sys.exc_info()[0]:
                self._approach(park)
        finally:
            for_all([*held, self.stack.close, *self.observers.closes(), *self._resources])


def _listed(faults: Mapping[str, str]) -> str:
    return "; ".join(f"{name}: {reason}" for name, reason in faults.items())
