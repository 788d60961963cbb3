"""People lead robots through many takes, in one loop that goes on until they end it."""

from __future__ import annotations

import math
import re
import time
from collections.abc import Callable, Mapping
from typing import Any

from rcs.agents import Agent, Event, Pace
from rcs.agents.action_writer import after_hold
from rcs.envs.env import Env
from rcs.envs.spaces import Observation
from rcs.envs.step.judge import FAULT
from rcs.errors import RcsError
from rcs.rollout.takes import LoopStatistics, Takes, instructed, verdict_of
from rcs.teleop.takeover import end_policies, people_of

VERDICTS: Mapping[Event, bool] = {"success": True, "failure": False}
"""Events that end a take with a verdict."""
OVER = "The episode is over. Reset to go on."
AGAIN = 2.0
"""Time without a refusal after which the same one is shown again [s]."""


class Teleoperation:
    """One running loop over many takes.

    The events of the agent act: `start` begins a take, or ends it with the verdict of the task, if it has one;
    `success`, `failure` and `discard` end it; `reset` begins the next episode, also after a fault, and keeps a take
    under way without a verdict; `stop` ends all.
    In simulation, a take that has ended is followed by the next episode, a discarded one by the same again. On real
    robots the loop goes on, and the person leads the robot to where the next take begins, also one of a policy that
    may be taken over; a policy beside a person rests until `reset`. Whenever a take ends, all devices hold, and the
    person has to press the clutch anew. One under way when all ends, also by Ctrl-C, is kept without a verdict.
    """

    def __init__(
        self,
        env: Env,
        agent: Agent,
        *,
        takes: Takes | None = None,
        seed: int = 0,
        report: Callable[[str], None] = lambda words: None,
    ) -> None:
        """Prepare; nothing moves.

        Args:
            env: The environment; its episodes best have no limit of steps.
            agent: An operator, or agents with operators among them.
            takes: Takes with a recorder of the environment; None for no recording.
            seed: Seed of the first episode.
            report: Called with words about takes and faults.

        Raises:
            InvalidSetup: The agent's rate does not divide the environment's.
        """
        self.env, self.agent, self.takes = env, agent, takes
        self.seed = seed
        """Seed of the present episode."""
        self.statistics = LoopStatistics(env.frequency)
        """How well the loop keeps its rate."""
        self.observation: Observation = {}
        """The present observation."""
        self.info: Mapping[str, Any] = {}
        """Info of the last step, or of the reset, with the instruction of the take."""
        self.is_over = True
        """Whether the episode is over, by a fault, so that only `reset` goes on."""
        self.is_ending = False
        """Whether the loop ends."""
        self._pace, self._report = Pace(env, agent), report
        self._ended: float | None = None
        self._told: str | None = None
        self._refused: dict[str, float] = {}
        """When each refusal was last made."""
        self._verdict: bool | None = None
        """Verdict of the take that is being written."""

    @property
    def is_simulated(self) -> bool:
        """Whether everything is simulated, so that an episode can begin anew without anybody's help."""
        return set(self.env.platform.values()) == {"simulation"}

    def begin(self, seed: int | None = None) -> None:
        """Begin an episode; real robots stay where they are.

        Args:
            seed: Its seed; None for the one after the present one.

        Raises:
            DeviceFault: A device is in its fault state.
        """
        seed = self.seed + 1 if seed is None else seed
        self.observation, info = self.env.reset(seed=seed)
        self.info, self.seed = instructed(info, self.takes), seed
        self._pace.reset(self.observation, self.info)
        self.is_over, self._ended = False, None

    def run(self, is_done: Callable[[], bool] = lambda: False) -> None:
        """Go on until the event `stop`, or until `is_done`, called after every step, returns True.

        All devices hold at the end, also after an error or Ctrl-C.
        """
        try:
            self.begin(self.seed)
            while not self.is_ending and not is_done():
                self.advance()
        except KeyboardInterrupt:
            self._keep_take()
            raise
        else:
            self._keep_take()
        finally:
            self.env.hold()

    def advance(self) -> None:
        """Make a step, or wait for a period if the episode is over; then carry out the person's requests."""
        action = self._pace.act(self.observation, self.info)
        if self.is_over:
            time.sleep(1.0 / self.env.frequency)
        else:
            self._step(action)
        message = self.agent.failure_message
        if message and message != self._told:  # such as of a policy that is lost, while which the robot holds
            self._report(message)
        self._told = message
        for event in self.agent.events():
            self.obey(event)

    def obey(self, event: Event) -> None:
        """Carry out a person's request."""
        if event == "stop":
            self.is_ending = True
        elif event == "reset":
            self._keep_take()
            self._begin_anew()
        elif event in ("start", "discard", *VERDICTS):
            self._judge(event)

    # --- Steps --------------------------------------------------------------------------------------------------------

    def _step(self, action: Mapping[str, Any]) -> None:
        self.env.note(**self._pace.notes())
        self.observation, _, terminated, truncated, info = self.env.step(action)
        self.info = instructed(info, self.takes)
        now = time.monotonic()
        if self._ended is not None:
            self.statistics.add(now - self._ended, self.info)
            if self.takes is not None:
                self.takes.add(now - self._ended, self.info)
        self._ended = now
        if not terminated and not truncated:
            if "refused" in self.info:
                self._tell_refusal(str(self.info["refused"]), now)
            return
        self.is_over = True
        if faults := self.info.get("faults"):
            words = "; ".join(f"{name}: {why}" for name, why in faults.items())
            self._report(f"{'Fault' if self.info['end'] == FAULT else 'The episode is over'}: {words}. Reset to go on.")
        elif self.takes is not None and self.takes.is_recording:
            self._end(self.takes, verdict_of(self.info))
        elif self.is_simulated:
            self.begin()
        else:
            self._report(OVER)

    def _tell_refusal(self, why: str, now: float) -> None:
        """Report why a gate lets nothing through, once as long as it refuses for the same reason."""
        words = without_figures(why)
        if now - self._refused.get(words, -math.inf) > AGAIN:
            self._report(f"Refused: {why}")
        self._refused[words] = now

    def _begin_anew(self) -> None:
        """Clear faults and begin the next episode; while they stay it is over, and a person may ask again."""
        try:
            if self.info.get("faults") or self.env.stack.faults():
                self.env.recover()
            self.is_over = True
            self.begin()
        except RcsError as err:
            self._report(f"{type(err).__name__}: {err} Reset to try again.")

    # --- Takes --------------------------------------------------------------------------------------------------------

    def _judge(self, event: Event) -> None:
        takes = self.takes
        if takes is None:
            self._report("Nothing is recorded; give a folder to record into.")
        elif event == "start" and takes.now is None:
            self._report("The episode is over. Reset before the next take." if self.is_over else takes.start())
        elif takes.now is None:
            self._report("There is no take; start one first.")
        elif event == "discard":
            self._end(takes, None, is_kept=False)
        elif takes.is_recording:
            self._end(takes, VERDICTS[event] if event in VERDICTS else verdict_of(self.info))

    def _keep_take(self) -> None:
        """Keep a take under way; it has no verdict unless Ctrl-C interrupted its end."""
        if self.takes is not None and self.takes.is_recording:
            self.env.hold()  # writing takes longer than a period
            self._report(self.takes.finish(self._verdict))

    def _end(self, takes: Takes, success: bool | None, *, is_kept: bool = True) -> None:
        self.env.hold()  # writing takes longer than a period
        self._verdict = success
        self._report(takes.finish(success) if is_kept else takes.discard())
        self._verdict = None
        if self.is_simulated:
            self.begin(None if is_kept else self.seed)
        elif self.is_over:
            self._report(OVER)
        else:
            self._ended = None
            self.info = go_on_from_hold(self._pace, self.observation, instructed(self.info, self.takes))


def go_on_from_hold(pace: Pace | None, observation: Observation, info: Mapping[str, Any]) -> dict[str, Any]:
    """Have people go on after `Env.hold`, and no policy beside them; return the info to go on with.

    Args:
        pace: The present agent; one without people begins anew; None for none.
        observation: The present observation.
        info: Info of the last step.
    """
    if pace is not None and (people := people_of(pace.agent)):
        end_policies(pace.agent, observation, info)
        for person in people:
            person.take_over(observation, info)
    elif pace is not None:
        pace.reset(observation, info)
    return after_hold(info)


def without_figures(words: str) -> str:
    """Return words without their figures, which change all the time, to see whether they say anything new."""
    return re.sub(r"(?<![A-Za-z_\d])[-+]?[\d.]+", "", words)
