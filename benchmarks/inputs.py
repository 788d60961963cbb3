"""Pick the cuboid with each input, over its real path but without the device: a scripted person plays its other end.

`--input NAME`: `spacemouse` (reports through a file like the kernel's), `gamepad` (SDL's virtual joystick), `keyboard`
(a terminal with kitty's protocol), `quest` (frames over TLS), `vive` (packets of the relay), `so101_leader`, `gello`
(servos in a process of their own, behind a serial line). The person sees what the expert sees, 30 times a second in
real time, and leads the FR3 in simulation, or the SO101 by its leader; every take is recorded. Prints one JSON object:
`successes`, `takes`, `damage` (found by `rcs data check`), `seconds` (median length of a take), `held` (times that the
robot was held within takes), `readings`, `left_out` (of them, by their flaw); `busy` is true if other programs used
more than a quarter of the cores meanwhile.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import tyro
from rcs_data import Dataset
from rcs_data.check import check
from rehearsal.other_ends import ENDS, End, Want
from rehearsal.other_programs import watch

import rcs
from rcs.agents import Agent, Event, PickExpert
from rcs.envs import Note
from rcs.envs.spaces import JOINTS, TQUAT, Action, Observation
from rcs.rollout import Takes, Teleoperation
from rcs.spatial import compose, distance, inverse, limit_step
from rcs.teleop import Button, Operator

NEAR = 0.05
"""Distance of the TCP from the expert's target up to which the expert goes on [m]: a person waits for the robot."""
HAND = 0.25, 1.0
"""Speeds of the hand [m/s, rad/s]."""
JOINT = 0.8
"""Speed of a leader's joints [rad/s]."""
PRESS = 0.15
"""Time for which a button is pressed [s]."""
LONGEST = 90.0
"""Longest take [s]."""


@dataclass(kw_only=True)
class Options:
    """Options of the benchmark."""

    input: Literal["spacemouse", "gamepad", "keyboard", "quest", "vive", "so101_leader", "gello"] = "spacemouse"
    """The input."""
    takes: int = 12
    """Takes to record."""
    seed: int = 0
    """Seed of the first episode."""


class Calm(PickExpert):
    """The expert at the speed of a person's wrist."""

    turn_speed = 1.0


class Person(Agent):
    """Sees what the expert sees, and has the other end of the input do what leads the robot there."""

    def __init__(self, env: rcs.envs.Env, end: End) -> None:
        self.expert, self.end = Calm(env), end
        self.operator = Operator(env, end.device)
        self.held = 0
        self._period, self._time = 1.0 / env.frequency, 0.0
        self._pressed: dict[Button, float] = {}
        self._clutch_at = 0.0
        self._state = ""
        self._joints: Any = None
        self._goal: Any = None

    def reset(self, observation: Observation, info: Mapping[str, Any]) -> None:
        """Begin an episode: release everything, then begin a take and press the clutch."""
        self._time, self._clutch_at, self._state = 0.0, 0.6, ""
        self._pressed = {"start": 0.3}
        self.expert.reset(observation, info)
        self.operator.reset(observation, info)
        self._opening_at = 0.0
        self._joints = self._goal = np.array(observation[JOINTS])

    def act(self, observation: Observation, info: Mapping[str, Any]) -> Action:
        """Move the hands, and return what the operator makes of it."""
        self._time += self._period
        tcp, arm = observation[TQUAT], self.expert.arms[0]
        state = self.operator.states["right"]
        if state == "held" and self._state == "engaged":
            self.held += 1
        is_free = state == "engaged" or (self.end.toggles and state == "released")
        if not is_free and self._time > self._clutch_at + 2.0:
            self._clutch_at = self._time + 0.4  # release, and press it again
        self._state = state
        is_leading = is_free and self._time > 0.8
        if is_leading and distance(tcp, arm.target)[0] < NEAR:
            self._goal = np.array(self.expert.act(observation, info)[JOINTS])
        opening = float(self.expert._phase.opening)
        want = self.end.want
        pose = (
            limit_step(want.pose, arm.target, *(speed * self._period for speed in HAND))
            if is_leading
            else np.array(tcp)
        )
        if not is_leading:
            self._joints = self._goal = np.array(observation[JOINTS])
            self._joints[0] += 0.05 * (self._time < self._clutch_at)  # a leader without a clutch has to be moved first
        most = JOINT * self._period
        self._joints = self._joints + np.clip(self._goal - self._joints, -most, most)
        self._toggle(opening)
        self.end.want = Want(pose, _way(tcp, arm.target), self._joints, opening, self._buttons())
        return self.operator.act(observation, info)

    def _toggle(self, opening: float) -> None:
        """Press the gripper's button if it has to open or close."""
        is_open = self.operator._hands["right"].guide.opening >= 0.5
        if self.end.toggles and is_open != (opening >= 0.5) and self._time > self._opening_at:
            self._pressed["gripper"] = self._time
            self._opening_at = self._time + 0.8

    def _buttons(self) -> frozenset[Button]:
        now = self._time
        held: set[Button] = {button for button, at in self._pressed.items() if at <= now < at + PRESS}
        if now >= self._clutch_at:
            held.add("clutch")
        return frozenset(held)

    @property
    def note_fields(self) -> Sequence[Note]:
        """The operator's."""
        return self.operator.note_fields

    def notes(self) -> Mapping[str, Any]:
        """Return the operator's."""
        return self.operator.notes()

    def events(self) -> Sequence[Event]:
        """Return the operator's; takes of a leader, which has no buttons, begin and fail by the clock."""
        events = list(self.operator.events())
        if not self.end.has_buttons:
            events += ["start"] if 0.3 <= self._time < 0.3 + self._period else []
        events += ["failure"] if self._time > LONGEST else []
        return events

    def close(self) -> None:
        """Disconnect."""
        self.operator.close()


def _way(tcp: Any, target: Any) -> Any:
    """Return the way between two poses along and about the axes of the base: translation [m], rotation vector [rad]."""
    turn = compose([0, 0, 0, *target[3:]], inverse([0, 0, 0, *tcp[3:]]))[3:]
    turn = turn if turn[3] >= 0 else -turn
    length = float(np.linalg.norm(turn[:3]))
    angle = 2.0 * np.arctan2(length, turn[3])
    return np.concatenate([target[:3] - tcp[:3], turn[:3] / max(length, 1e-9) * angle])


def main(options: Options) -> None:
    """Measure and print."""
    is_busy = watch()
    robot = "so101" if options.input == "so101_leader" else "fr3"
    with tempfile.TemporaryDirectory() as folder:
        os.environ["XDG_CONFIG_HOME"] = folder
        env = rcs.make(
            "PickCuboid", robot=robot, control="joints", relative="absolute", binary_gripper=False, stepping="realtime",
            max_episode_steps=None,
        )  # fmt: skip
        with env, ENDS[options.input](Path(folder)) as end:
            person = Person(env, end)
            person.operator.open()
            end.start()
            with rcs.record(env, Path(folder) / "takes", notes=person.note_fields) as recorder:
                takes = Takes(recorder, env.frequency)
                loop = Teleoperation(env, person, takes=takes, seed=options.seed, report=_report)
                loop.run(lambda: len(takes.ended) >= options.takes)
            feed = person.operator.feed
            person.close()
        episodes = list(Dataset.open(Path(folder) / "takes").episodes)
        result = {
            "input": options.input,
            "robot": robot,
            "successes": sum(one.success is True for one in episodes),
            "takes": len(episodes),
            "damage": len(check(Path(folder) / "takes").damage),
            "seconds": float(np.median([one.length for one in episodes])) / env.frequency,
            "held": person.held,
            "readings": feed.readings,
            "left_out": dict(feed.counts),
            "busy": is_busy(),
        }
    print(json.dumps(result))


def _report(words: str) -> None:
    print(words, file=sys.stderr)


if __name__ == "__main__":
    given = tyro.cli(Options)
    if given.input == "keyboard" and os.getsid(0) != os.getpid():  # only who leads a session can have a terminal
        raise SystemExit(subprocess.run([sys.executable, *sys.argv], start_new_session=True, check=False).returncode)
    main(given)
