"""Measure teleoperation: what a scripted person gets done, latency, rates of recording loops, and dead devices.

A scripted person is behind an input device without hardware, whose thread and readings are those of any other. Prints
one JSON object per part; the parts are those that are given, or `--pick` alone. `busy` is true if other programs used
more than a quarter of the cores meanwhile, so that times and rates say little.

`--pick`: the person sees the scene, picks the cuboid on the FR3 in simulation, and every take is recorded:
`successes`, `takes`, `damage` (found by `rcs data check`), `seconds` (median length of a take).
`--latency`, per rate and with and without the guard, on `hardware="sim"`: `act_p99_ms` (from `act` to the command),
`event_p99_ms` and `event_p50_ms` (from the sample of the hand to the command), `bound_ms` (a period and 2 ms), `equal`
(successive equal targets while the hand moves at 72 Hz).
`--loop`, per rate and number of cameras of 640 x 480 at 30 frames/s, all devices fake, recording: `rate_hz`,
`deviation_hz`, `late`, `lost` (images by the cameras' own numbers that are neither stored nor flagged), `flagged`,
`cores` (processor time over wall time).
`--drop`, in simulation and on `hardware="sim"`, 20 times per fate: `worst_way_mm` (way of the TCP later than
`valid_for` and 0.1 s after the device has died), `back_way_mm` (way while the device is back, before the clutch),
`speed_m_s` (largest speed of the TCP afterwards); on `hardware="sim"` also with `act` blocked for 2 s (`blocked`).
With `--input NAME`, an input of `inputs.py`, `page` (keys of the page) or `pedal` is killed at its other end instead.
"""

from __future__ import annotations

import itertools
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from rcs_data import Dataset
from rcs_data.check import check
from rcs_data.files.flags import FrameFlag
from rehearsal.dead_inputs import Person, drop, held
from rehearsal.other_programs import watch

import rcs
from rcs.agents import Agent, Event, PickExpert
from rcs.envs import Guard, Note
from rcs.envs.spaces import Action, Observation
from rcs.hardware import Site
from rcs.rollout import Latency, LoopStatistics, Takes, Teleoperation
from rcs.setups import lab_of
from rcs.teleop import Button, HandReading, Operator


@dataclass(kw_only=True)
class Options:
    """Options of the benchmark."""

    pick: bool = False
    latency: bool = False
    loop: bool = False
    drop: bool = False
    takes: int = 12
    """Takes of `--pick`."""
    steps: int = 1000
    """Steps per rate of `--latency` and `--loop`."""
    rates: tuple[float, ...] = (30.0, 90.0, 120.0)
    """Rates of `--latency` [Hz]."""
    loops: tuple[tuple[float, int], ...] = ((90.0, 2), (120.0, 2), (90.0, 6))
    """Rates [Hz] and numbers of cameras of `--loop`."""
    mode: str = "640x480"
    """Mode of the cameras of `--loop`, such as 1280x720."""
    times: int = 20
    """Deaths per fate of `--drop`."""
    input: str | None = None
    """Input that `--drop` kills; by default a stand-in without hardware dies in several ways."""
    seed: int = 0
    """Random seed of episodes and moments."""


def main(options: Options) -> None:
    """Measure and print."""
    parts = {"pick": pick, "latency": latency, "loop": loop, "drop": lambda own: drop(own.times, own.seed, own.input)}
    for name in [name for name in parts if getattr(options, name)] or ["pick"]:
        is_busy = watch()
        for result in parts[name](options):
            print(json.dumps({"part": name, **result, "busy": is_busy()}))


# --- Work of a person -------------------------------------------------------------------------------------------------


class Calm(PickExpert):
    """The expert at the speed of a person who knows that the robot is slower than the hand."""

    turn_speed = 1.0
    phases = tuple(replace(phase, speed=min(phase.speed, 0.18)) for phase in PickExpert.phases)


class Picking(Agent):
    """A person who sees what the expert sees, and moves the hand as that would move the TCP."""

    def __init__(self, env: rcs.envs.Env, person: Person) -> None:
        self.expert, self.person = Calm(env), person
        self.now, self.period, self.began = 0.0, 1.0 / env.frequency, 0.0
        person.clock = lambda: self.now
        self.operator = Operator(env, person, clock=person.clock, has_thread=False)

    def reset(self, observation: Observation, info: Mapping[str, Any]) -> None:
        """Begin an episode."""
        self.began = self.now
        self.expert.reset(observation, info)
        self.operator.reset(observation, info)

    def act(self, observation: Observation, info: Mapping[str, Any]) -> Action:
        """Move the hand, and return what the operator makes of it."""
        self.now += self.period
        passed = self.now - self.began
        buttons: list[Button] = ["clutch"] if passed > 0.2 else []
        buttons += ["start"] if 0.3 < passed < 0.4 else []
        buttons += ["failure"] if passed > 30.0 else []
        if passed > 0.4:
            self.expert.act(observation, info)
        opening = float(self.expert._phase.opening)
        self.person.hand = held(self.expert.arms[0].target, *buttons, opening=opening)
        return self.operator.act(observation, info)

    @property
    def note_fields(self) -> Sequence[Note]:
        """The operator's."""
        return self.operator.note_fields

    def notes(self) -> Mapping[str, Any]:
        """Return the operator's."""
        return self.operator.notes()

    def events(self) -> Sequence[Event]:
        """Return the operator's."""
        return self.operator.events()

    def close(self) -> None:
        """Disconnect."""
        self.operator.close()


def pick(options: Options) -> list[dict[str, Any]]:
    """Pick the cuboid until there are enough takes."""
    with tempfile.TemporaryDirectory() as folder, rcs.make("PickCuboid", max_episode_steps=None) as env:
        agent = Picking(env, Person())
        with rcs.record(env, Path(folder) / "takes", notes=agent.note_fields) as recorder:
            takes = Takes(recorder, env.frequency)
            Teleoperation(env, agent, takes=takes, seed=options.seed).run(lambda: len(takes.ended) >= options.takes)
        agent.close()
        episodes = list(Dataset.open(Path(folder) / "takes").episodes)
        report = check(Path(folder) / "takes")
        return [
            {
                "robot": "fr3",
                "successes": sum(one.success is True for one in episodes),
                "takes": len(episodes),
                "damage": len(report.damage),
                "seconds": float(np.median([one.length for one in episodes])) / env.frequency,
            }
        ]


# --- Latency ----------------------------------------------------------------------------------------------------------


class Sent(rcs.envs.Observer):
    """Remembers when targets were sent, and what they were."""

    def __init__(self) -> None:
        self.times: list[float] = []
        self.targets: list[bytes] = []

    def on_reset(self, first: Any, seed: int | None) -> None:
        """Begin."""

    def on_step(self, transition: Any) -> None:
        """Remember a step."""
        self.times.append(transition.command_time)
        self.targets.append(transition.executed["joints"].tobytes())


def latency(options: Options) -> list[dict[str, Any]]:
    """Measure from the hand to the command."""
    results: list[dict[str, Any]] = []
    for rate in options.rates:
        for is_guarded in (False, True):
            gates: Any = [Guard] if is_guarded else ()
            with rcs.make("Free", hardware="sim", frequency=rate, max_episode_steps=None, gates=gates) as env:
                sent, measured = Sent(), Latency()
                env.add_observer(sent)
                env.add_observer(measured)
                person = Person()
                operator = Operator(env, person)
                observation, info = env.reset(seed=0)
                operator.reset(observation, info)
                person.hand = circling()
                acted: list[float] = []
                for _ in range(options.steps):
                    acted.append(time.monotonic())
                    action = operator.act(observation, info)
                    env.note(**operator.notes())
                    observation, _, _, _, info = env.step(action)
                require_engaged(operator)
                operator.close()
            moving = round(1.0 * rate)  # the hand moves from then on
            taken = 1e3 * (np.array(sent.times) - np.array(acted))
            event = 1e3 * np.array(measured.commands)
            results.append(
                {
                    "rate_hz": rate,
                    "guard": is_guarded,
                    "act_p99_ms": float(np.percentile(taken, 99)),
                    "event_p50_ms": float(np.median(event)),
                    "event_p99_ms": float(np.percentile(event, 99)),
                    "bound_ms": 1e3 / rate + 2.0,
                    "equal": sum(a == b for a, b in itertools.pairwise(sent.targets[moving:])),
                }
            )
    return results


def circling() -> Callable[[float], HandReading]:
    """Return a hand that presses the clutch in half a second, and makes a circle from then on."""
    began = time.monotonic() + 0.5

    def hand(now: float) -> HandReading:
        turn = max(now - began, 0.0)
        return held((0.05 * np.cos(turn), 0.05 * np.sin(turn), 1.0, 0, 0, 0, 1), *(["clutch"] if turn else []))

    return hand


def require_engaged(operator: Operator) -> None:
    """Refuse to measure a robot that does not follow to the end; one that was held stays so."""
    if set(operator.states.values()) != {"engaged"}:
        raise SystemExit(f"The robot does not follow, so that nothing can be measured: {operator.problem}")


# --- Rate -------------------------------------------------------------------------------------------------------------


def loop(options: Options) -> list[dict[str, Any]]:
    """Record cameras beside loops of several rates."""
    results: list[dict[str, Any]] = []
    for rate, count in options.loops:
        names = [f"camera{i}" for i in range(count)]
        mount = replace(lab_of("fr3").cameras["side"], calibration=None)  # which is that of one shape of pictures
        cameras = rcs.Cameras(names=tuple(names), mounts=dict.fromkeys(names, mount), mode=options.mode, fps=30)
        fakes = {name: f"fake:{name}" for name in names}
        site = Site(arms={"fr3": "fake:a"}, grippers={"fr3": "fake:g"}, cameras=fakes)
        env = rcs.make("Free", hardware=site, frequency=rate, max_episode_steps=None, cameras=cameras)
        with tempfile.TemporaryDirectory() as folder, env:
            person = Person()
            operator = Operator(env, person)
            statistics = LoopStatistics(rate)
            with rcs.record(env, Path(folder) / "takes", notes=operator.note_fields) as recorder:
                recorder.start(at_reset=True)
                observation, info = env.reset(seed=0)
                operator.reset(observation, info)
                person.hand = circling()
                usage, began = resource.getrusage(resource.RUSAGE_SELF), time.monotonic()
                last = began
                for _ in range(options.steps):
                    env.note(**operator.notes())
                    observation, _, _, _, info = env.step(operator.act(observation, info))
                    now = time.monotonic()
                    statistics.add(now - last, info)
                    last = now
                after, wall = resource.getrusage(resource.RUSAGE_SELF), time.monotonic() - began
                recorder.finish(success=None)
            require_engaged(operator)
            operator.close()
            (take,) = Dataset.open(Path(folder) / "takes").episodes
            lost = flagged = 0
            for name in names:
                (images,) = take.image_numbers([f"observation/frames/{name}/rgb"]).values()
                numbers = np.round(30.0 * np.asarray(take.column(f"time/device/frames/{name}")))
                flags = np.asarray(take.column(f"flags/frames/{name}")).astype(int)
                # Rows that repeat a frame that was left out have both flags.
                dropped = int((flags & (FrameFlag.DROPPED | FrameFlag.REPEATED) == FrameFlag.DROPPED).sum())
                flagged += dropped
                lost += int(np.ptp(numbers)) + 1 - len(np.unique(images)) - dropped
        mean, deviation = statistics.rates
        cpu = after.ru_utime + after.ru_stime - usage.ru_utime - usage.ru_stime
        results.append(
            {
                "rate_hz": rate, "cameras": count, "mode": options.mode, "steps": options.steps, "mean_hz": mean,
                "deviation_hz": deviation, "late": statistics.late, "lost": lost, "flagged": flagged,
                "cores": cpu / wall,
            }
        )  # fmt: skip
    return results


if __name__ == "__main__":
    given = tyro.cli(Options)
    if given.input == "keyboard" and os.getsid(0) != os.getpid():  # only who leads a session can have a terminal
        raise SystemExit(subprocess.run([sys.executable, *sys.argv], start_new_session=True, check=False).returncode)
    main(given)
