"""An environment, simulated or real, that goes on step by step while a person leads its robots."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from rcs_data.files.closing import Closing

from rcs.agents import Agent, Event, Pace, agent_for
from rcs.agents.guide import Guide
from rcs.devices import lookup
from rcs.envs.env import Env
from rcs.envs.observer import Note
from rcs.envs.observers.record import record
from rcs.envs.setup import Setup
from rcs.envs.spaces import FRAMES, JOINTS, RGB, Action, Observation
from rcs.envs.step.judge import DIVERGED, FAULT
from rcs.envs.step.stack import for_all
from rcs.errors import DeviceFault, RcsError, WrongOrder
from rcs.rollout.takes import LoopStatistics, Takes, instructed, verdict_of
from rcs.rollout.teleoperate import VERDICTS, go_on_from_hold
from rcs.setups.make import make, resolve
from rcs.sim.timed_world import TimedWorld
from rcs.sim.world import World
from rcs.teleop import InputDevice, Keyboard, Operator
from rcs.teleop.operator import notes_of
from rcs.teleop.takeover import end_policies, people_of

ACTOR = Note("actor", words=("page", "agent", "policy", "person"))
"""The actor of a row: the person at the page, or an agent; in a takeover, its policy or its person."""


def playable(setup: Setup, *, keep_gripper: bool = False) -> Setup:
    """Return a setup for interactive use: at the rate of the wall clock, without a limit of steps.

    A gripper opens by degrees; a hand still opens and closes as a whole.

    Args:
        setup: The setup.
        keep_gripper: Keep the gripper commands of the setup, for an agent that was trained in it.

    Raises:
        UnknownName: The setup names something that is not there.
        InvalidSetup: Its parts do not fit each other.
    """
    has_hand = any(robot.hand is not None for robot in resolve(setup).robots)
    is_binary = setup.binary_gripper if keep_gripper else has_hand
    return replace(setup, stepping="realtime", max_episode_steps=None, binary_gripper=is_binary)


class Session(Closing):
    """Episodes of an environment, one after the other, used by one thread. A context manager.

    Errors of a step do not end it: `problem` has the message, and `recover` goes on. An agent, or the person behind it,
    acts at its own rate, and `obey` carries out its requests.
    """

    def __init__(
        self,
        setup: Setup | Env,
        *,
        seed: int = 0,
        agent: Any = None,
        hardware: Any = None,
        record_into: Path | None = None,
        instructions: Sequence[str] = (),
    ) -> None:
        """Make the environment and begin its first episode.

        Args:
            setup: The setup, as `playable` returns it, or an environment, which `close` closes, too.
            seed: Seed of the first episode.
            agent: Agent that may act in place of the person, as `agent_for` takes it; None for the task's expert.
            hardware: Real devices of a setup, as in `rcs.make`; None for simulation alone.
            record_into: Folder of the dataset of takes; None for no recording.
            instructions: Instructions of the takes, in turn; none for that of the environment.

        Raises:
            UnknownName: The setup names something that is not there.
            InvalidSetup: Its parts do not fit each other, or a layer leaves actions that a person cannot make.
        """
        self.observation: Observation = {}
        """The present observation."""
        self.info: Mapping[str, Any] = {}
        """Info of the last step, or of the reset."""
        self.takes: Takes | None = None
        """The takes, from the first one on; None before it, and without a folder."""
        self._actor, self._record_into, self._instructions = agent, record_into, instructions
        self._recording = ExitStack()
        self._pace: Pace | None = None
        self.operator: Operator | None = None
        """The person at the keys of the page, while those lead."""
        self._ended: float | None = None
        self._began = 0.0
        self.episodes = 0
        """Episodes that have begun."""
        self.env: Env = setup if isinstance(setup, Env) else make(setup, hardware=hardware)
        self._mirror = None if self.env.is_simulated else TimedWorld(list(self.env.robots.values()))
        try:
            self.guides: dict[str, Guide] = {name: Guide(self.env, robot) for name, robot in self.env.robots.items()}
            """The guide of each robot, by its name."""
            self.is_playing = True
            """Whether `advance` makes steps."""
            self.seed = seed
            """Seed of the present episode."""
            self._begin(seed, None)
        except BaseException:
            self.close()
            raise

    # --- State --------------------------------------------------------------------------------------------------------

    @property
    def setup(self) -> Setup:
        """The setup."""
        return self.env.setup

    @property
    def world(self) -> World:
        """The simulated world; where all is real, a picture of the robots as they are measured."""
        return self.env.simulation.world if self._mirror is None else self._mirror.world

    @property
    def time(self) -> float:
        """Time of the present episode [s], by the clock of the environment."""
        return float(self.info.get("time", 0.0)) - self._began

    @property
    def can_record(self) -> bool:
        """Whether there is a folder for takes."""
        return self._record_into is not None

    @property
    def agent(self) -> Agent | None:
        """The agent that acts in place of the person; None if the person does."""
        return None if self._pace is None else self._pace.agent

    @property
    def has_agent(self) -> bool:
        """True if there is an agent to act in place of the person."""
        return self._actor is not None or lookup.find("task", self.setup.task).expert is not None

    @property
    def frames(self) -> dict[str, Any]:
        """The last colour frames by camera, (H, W, 3) uint8."""
        return {name: frame[RGB] for name, frame in self.observation.get(FRAMES, {}).items()}

    @property
    def verdict(self) -> str:
        """State of the episode in one word: running, paused, stopped by an error, success, or over without it."""
        if self.problem:
            return "stopped"
        if self.is_over:
            return "success" if self.info.get("success", False) else "over"
        return "running" if self.is_playing else "paused"

    # --- Control ------------------------------------------------------------------------------------------------------

    def reset(self, seed: int | None = None) -> None:
        """Begin an episode.

        Args:
            seed: Seed of the episode; None for the one after the present one.

        Raises:
            RcsError: The environment cannot be reset; `problem` has the message, too.
        """
        self._begin(self.seed + 1 if seed is None else seed, None)

    def recover(self) -> None:
        """Clear faults and go on: from where everything is after a fault, anew after anything else.

        Raises:
            RcsError: It cannot go on; `problem` has the message, too.
        """
        self.env.recover()
        state = self.world.states() if self._is_fault and self._mirror is None else None
        self._begin(self.seed, state)

    def let_agent(self, is_acting: bool) -> None:
        """Let the agent act in a new episode with the present seed, or take over from it.

        Raises:
            InvalidSetup: There is no agent, and the task has no expert; or it does not fit the environment.
        """
        self._end_agent()
        if is_acting:
            self._pace = Pace(self.env, agent_for(self.env, self._actor))
            self._begin(self.seed, None)

    def let_keys(self, keys: InputDevice | None, robot: str = "") -> None:
        """Have keys of the page lead a robot from where it is, or its targets and sliders again.

        Args:
            keys: The keys; None for none.
            robot: The robot that they lead; the others stay.

        Raises:
            InvalidSetup: A person cannot lead the robot step by step.
        """
        self._end_agent()
        if keys is not None:
            operator = Operator(self.env, keys, robots={keys.hands[0]: robot})
            self._pace, self.operator = Pace(self.env, operator), operator
            operator.open()
            operator.take_over(self.observation, self.info)

    def step(self) -> None:
        """Make one step, of one control period, unless the episode is over."""
        if self.is_over:
            return
        try:
            step = self.env.step(self._action())
        except RcsError as err:
            self.problem, self.is_over = f"{type(err).__name__}: {err}", True
            self._is_fault = isinstance(err, DeviceFault)
            return
        self.observation, reward, terminated, truncated, info = step
        self.info = instructed(info, self.takes, self._instructions)
        self._count()
        self.reward = float(reward)
        for guide in self.guides.values():
            guide.see(self.observation) if self.agent is None else guide.reset(self.observation)
        self.steps += 1
        self.total += self.reward
        self.is_over = terminated or truncated
        if faults := self.info.get("faults"):
            self.problem = "; ".join(f"{name}: {why}" for name, why in faults.items())
            self._is_fault = self.info["end"] == FAULT
        elif self.info["end"] == DIVERGED:
            self.problem, self._is_fault = "The simulation diverged.", False
        elif self.is_over and self.takes is not None and self.takes.is_recording:
            self._end_take(self.takes, verdict_of(self.info))
        if self.agent is not None:
            for event in self.agent.events():
                self.obey(event)

    def obey(self, event: Event) -> None:
        """Carry out a person's request, as `Teleoperation` does; `takeover` takes the robots from an agent.

        Raises:
            WrongOrder: A take is to end, and there is none; or to begin, without a folder or after the episode's end.
        """
        if event == "stop" and not self.is_over:
            self.env.hold()
            self.is_over = True
        elif event == "reset":
            if self._is_fault:
                self.env.recover()
            self.reset()
        elif event == "takeover" and not people_of(self.agent):  # they have a policy to take over, or none
            self.let_agent(self.agent is None)
        elif event in ("start", "discard", *VERDICTS):
            self._judge(event)

    def release(self) -> None:
        """Have all robots brake and stay, because the page that led is gone; an agent acts no longer.

        A person at an input device still leads, and has the robots of a policy that may be taken over.
        """
        pace = None if people_of(self.agent) else self._take_off_agent()
        self._brake()
        end_policies(self.agent, self.observation, self.info)
        if pace is not None:
            pace.agent.close()

    def _brake(self) -> None:
        for guide in self.guides.values():
            guide.brake()
        if self.operator is not None:
            self.operator.hold("nobody leads")

    def _count(self) -> None:
        now = time.monotonic()
        if self._ended is not None:
            self.statistics.add(now - self._ended, self.info)
            if self.takes is not None:
                self.takes.add(now - self._ended, self.info)
        self._ended = now
        if self._mirror is not None:
            self._show_measured(self._mirror)

    def _show_measured(self, mirror: TimedWorld) -> None:
        """Put the robots of the picture where they are measured."""
        is_alone, seen = len(mirror.arms) == 1, self.observation
        mirror.start(mirror.time, {name: (seen if is_alone else seen[name])[JOINTS] for name in mirror.arms})

    # --- Takes --------------------------------------------------------------------------------------------------------

    def _judge(self, event: Event) -> None:
        if self._record_into is None:
            raise WrongOrder("Nothing is recorded; give a folder to record into.")
        if self.takes is None:
            fields = [*notes_of(Keyboard), *(() if self.agent is None else self.agent.note_fields), ACTOR]
            notes = {note.name: note for note in fields}  # keys may lead later, and all takes have the same notes
            recorder = self._recording.enter_context(record(self.env, self._record_into, notes=list(notes.values())))
            self.takes = Takes(recorder, self.env.frequency, instructions=self._instructions)
        takes = self.takes
        if event == "start" and takes.now is None:
            if self.is_over:
                raise WrongOrder("The episode is over; reset before the next take.")
            takes.start()
        elif event == "discard":
            self._end_take(takes, None, is_kept=False)
        else:
            self._end_take(takes, VERDICTS[event] if event in VERDICTS else verdict_of(self.info))

    def _end_take(self, takes: Takes, success: bool | None, *, is_kept: bool = True) -> None:
        """End a take, and begin the next episode, or the same again; real robots stay where they are."""
        if takes.is_recording or (takes.now is not None and not is_kept):  # otherwise there is nothing to end
            self.env.hold()  # writing takes longer than a period
        takes.finish(success) if is_kept else takes.discard()
        if set(self.env.platform.values()) == {"simulation"}:
            self._begin(self.seed + is_kept, None)
        elif not self.is_over:
            self._ended = None
            for guide in self.guides.values():
                guide.reset(self.observation)
                guide.keep_opening(self.info)
            try:
                self._brake() if people_of(self.agent) else self.release()
            finally:  # also if an agent cannot be closed
                self.info = go_on_from_hold(self._pace, self.observation, self.info)

    def advance(self) -> bool:
        """Make a step if the session is playing and the episode not over; return whether one was made."""
        if self.is_over and self._pace is not None and people_of(self._pace.agent):  # they may ask for the next episode
            self._pace.act(self.observation, self.info)
            for event in self._pace.agent.events():
                self.obey(event)
        if not self.is_playing or self.is_over:
            return False
        self.step()
        return True

    def _action(self) -> Action:
        if self._pace is not None:
            action = self._pace.act(self.observation, self.info)
            page = {} if self.operator is None else {"actor": "page"}
            self.env.note(**{"actor": "agent", **self._pace.notes(), **page})
            return action
        self.env.note(actor="page")
        actions = {name: guide.act(self.observation, self.info) for name, guide in self.guides.items()}
        return actions if len(actions) > 1 else next(iter(actions.values()))

    def _begin(self, seed: int, state: Any) -> None:
        self.problem = ""
        """Why the episode was stopped; empty if nothing is wrong."""
        self._is_fault = False
        self.is_over = True
        """Whether the episode is over, so that only `reset` and `recover` go on."""
        self.reward, self.total, self.steps = 0.0, 0.0, 0
        before, self.info = self.info, {}
        self.statistics = LoopStatistics(self.env.frequency)
        """How well the loop has kept its rate in this episode."""
        self._ended = None
        try:
            if self.takes is not None and self.takes.is_recording:
                self.env.hold()
                self.takes.finish(None)
            options = None if state is None or not np.isfinite(state).all() else {"state": state}
            self.observation, info = self.env.reset(seed=seed, options=options)
            self.info, self.seed = instructed(info, self.takes, self._instructions), seed
            self.episodes += 1
            self._began = float(self.info["time"])
            if self._pace is not None:
                self._pace.reset(self.observation, self.info)
        except RcsError as err:
            self.problem, self._is_fault = f"{type(err).__name__}: {err}", isinstance(err, DeviceFault)
            raise
        for guide in self.guides.values():
            guide.reset(self.observation)
        if state is not None:  # it goes on, and what is held must not fall
            for leader in (*self.guides.values(), *people_of(self.agent)):
                leader.keep_opening(before)
        if self._mirror is not None:
            self._show_measured(self._mirror)
        self.is_over = False

    def _end_agent(self) -> None:
        if (pace := self._take_off_agent()) is not None:
            pace.agent.close()

    def _take_off_agent(self) -> Pace | None:
        if (pace := self._pace) is not None:
            self._pace = self.operator = None
            for guide in self.guides.values():
                guide.keep_opening(self.info)
        return pace

    def close(self) -> None:
        """Keep a take that is open, without a verdict, and close the environment. Closing twice is harmless."""
        calls: list[Callable[[], None]] = [self._recording.close, self._end_agent, self.env.close]
        for_all(calls if self._mirror is None else [*calls, self._mirror.close])
