"""Records every step of an environment into a dataset."""

from __future__ import annotations

import math
from collections.abc import Callable, Generator, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rcs_data import DatasetWriter, EpisodeRecord, EpisodeWriter, Feature
from rcs_data.files.flags import FrameFlag, camera_of, flags_key
from rcs_data.record.background import BackgroundEpisode

from rcs.envs.observer import Observer, Transition
from rcs.envs.observers.dataset_info import (
    ACTION,
    EXECUTED,
    NOTES,
    OBJECTS,
    OBSERVATION,
    SIMULATED_TIME,
    TIME_COMMAND,
    TIME_DEVICE,
    TIME_MONOTONIC,
    TIME_PERIOD,
    camera_of_time,
    is_derived,
)
from rcs.envs.spaces import ORIGIN
from rcs.envs.step.judge import DIVERGED, FAULT
from rcs.errors import InvalidSetup, WrongOrder

END, REASONS = "end", "reasons"
"""Keys of the outcome of an episode that was broken off: `fault`, `exception` or `closed`; the faults by device, or the
error's message by its class."""
RECONNECTIONS = "reconnections"
"""Key of an outcome: how often devices were connected again during the episode, by key, where they were."""


class Recorder(Observer):
    """Writes the episodes of one environment. An episode is kept by `finish` and dropped by `discard`.

    A person's episodes are takes: `start` numbers them after the last episode of the dataset, and `retake` repeats one.
    A new reset discards an open episode, which is then repeated. An episode that was broken off, by a fault or an
    error, is different: its outcome says `end` and `reasons`, and unless it is discarded on purpose it is kept, by the
    next reset or by `close`, without a verdict. `close` keeps an episode that is still open in the same way. A frame
    with the capture time of the row before is stored once and flagged as repeated.
    """

    def __init__(
        self,
        writer: DatasetWriter,
        *,
        names: Iterator[str] | None = None,
        background: bool = False,
        stale_after: float | None = None,
        device_facts: Callable[[], Mapping[str, Any]] = dict[str, Any],
    ) -> None:
        """Record into a dataset.

        Args:
            writer: The dataset; it stays open when the recorder is closed.
            names: Ids for episodes to be recorded unasked: each from reset to end, with the success that the task
                reports. None for episodes that `name_next` requests.
            background: Whether a thread encodes and writes, so that a loop that must keep its rate never waits. Then a
                writer that is too slow leaves out images, flagged and counted; otherwise the loop waits for it.
            stale_after: Age [s] of a frame, from capture to the end of the step, from which it is flagged as stale;
                None for never, as simulated frames are as old as their drawing takes.
            device_facts: Returns facts that open devices report, which each episode's outcome keeps.
        """
        self._names = names
        self._broken_off: dict[str, Any] = {}
        self._device_facts = device_facts
        self._first_facts: dict[str, Any] = {}
        self._reconnections: Mapping[str, int] = {}
        self._first_reconnections: Mapping[str, int] = {}
        self._writer = writer
        self._is_background = background
        self._stale_after = stale_after
        self._episode: EpisodeWriter | BackgroundEpisode | None = None
        self._next: tuple[str, str | None] | None = None
        self._starts_at_reset = True
        self._number: int | None = None
        """Number of the next take; None before the first."""
        self._take: tuple[str, str | None] | None = None
        """Id and instruction of the take under way."""
        self._last_take: tuple[str, str | None] | None = None
        self._last_time = 0.0
        self._last_captures: dict[str, float] = {}
        self._forms = {feature.key: (feature.numpy_dtype, feature.shape) for feature in writer.info.features}
        self._notes = {one.key: one for one in writer.info.features if one.key.startswith(f"{NOTES}/")}
        self._images: dict[str, list[str]] = {}
        for feature in writer.info.features:
            camera = camera_of(feature.key)
            if feature.is_image and camera is not None:
                self._images.setdefault(camera, []).append(feature.key)

    @property
    def is_recording(self) -> bool:
        """Whether an episode is open."""
        return self._episode is not None

    @property
    def take(self) -> str | None:
        """Id of the take under way; None for none."""
        return None if self._take is None else self._take[0]

    @property
    def rows(self) -> int:
        """Rows of the open episode; 0 if none is open."""
        return 0 if self._episode is None else self._episode.rows

    @property
    def dropped(self) -> int:
        """Images and rows of the open episode that were left out since the writer is too slow."""
        episode = self._episode
        return episode.dropped_images + episode.dropped_rows if isinstance(episode, BackgroundEpisode) else 0

    def name_next(self, episode_id: str, *, instruction: str | None = None, at_reset: bool = True) -> None:
        """Set the id of the next episode; without one, episodes are not recorded.

        Args:
            episode_id: The name of its folder.
            instruction: Instruction for the robot; None for the dataset's instruction.
            at_reset: Whether it begins with the next reset, or already with the next step.
        """
        self._next = (episode_id, instruction)
        self._starts_at_reset = at_reset

    def free_name(self, episode_id: str) -> str:
        """Return an id that no episode has: the given one, or with a number where a killed run has left that."""
        taken, name, number = self._writer.taken(), episode_id, 1
        while name in taken:
            number += 1
            name = f"{episode_id}-{number}"
        return name

    def forget_next(self) -> None:
        """Take back what `name_next` set."""
        self._next = None

    def start(self, instruction: str | None = None, *, at_reset: bool = False) -> str:
        """Begin a take with the next step or reset and return its id; a discarded take's number is given to the next.

        Args:
            instruction: Instruction for the robot; None for the dataset's instruction.
            at_reset: Whether to wait for the next reset, instead of beginning with the next step.

        Raises:
            WrongOrder: A take is under way.
        """
        self._forget_closed()
        if self._take is not None:
            raise WrongOrder(f"Take {self._take[0]!r} is under way; finish or discard it before the next.")
        if self._number is None:
            numbers = (int(name) for name in self._writer.taken() if name.isdigit())
            self._number = max(numbers, default=-1) + 1
        self._begin_take(f"{self._number:06d}", instruction, at_reset)
        self._number += 1
        return f"{self._number - 1:06d}"

    def retake(self, *, at_reset: bool = False) -> str:
        """Repeat the take under way, or else the last one kept, under the same id and instruction.

        Args:
            at_reset: As in `start`.

        Raises:
            WrongOrder: There was no take yet.
        """
        again = self._take or self._last_take
        if again is None:
            raise WrongOrder("There is no take to repeat; start one first.")
        if self._take is None:
            self._writer.remove_episode(again[0])
        self._drop()
        self._begin_take(*again, at_reset)
        return again[0]

    def _begin_take(self, take: str, instruction: str | None, at_reset: bool) -> None:
        self.name_next(take, instruction=instruction, at_reset=at_reset)
        self._take, self._last_take = (take, instruction), None

    def on_reset(self, first: Transition, seed: int | None) -> None:
        """Begin an episode with its first observation."""
        self._let_go()
        if self._names is not None:
            self._next = (next(self._names), None)
        if self._next is not None:
            self._begin(first, seed)

    def on_step(self, transition: Transition) -> None:
        """Record a step; one in which the simulation diverged has no row, because its result is lost.

        Raises:
            InvalidSetup: A value is not what the dataset has; the row is not recorded, and the episode stays open.
            DatasetError, CorruptEpisode: The disk is full or fails, or has changed what was written; the episode is
                aborted.
        """
        if self._broken_off and self._episode is not None:
            return  # a state was set; this step does not follow the rows so far
        is_lost = transition.info.get("end") == DIVERGED
        if self._episode is None:
            if self._next is not None and not self._starts_at_reset and not is_lost:
                # The episode starts with the observation after this step; the step itself is not part of it.
                self._begin(replace(transition, action=None, executed=None), None)
            return
        if not is_lost:
            period = transition.time - self._last_time
            self._last_time = transition.time
            self._add(transition, period)
        if self._names is not None and (transition.terminated or transition.truncated):
            if (end := transition.info.get("end")) in (DIVERGED, FAULT):  # `on_end` comes after the step
                self.on_end(end, {name: why for name, why in transition.info.get("faults", {}).items() if why})
            success = None if is_lost else transition.info.get("success")  # of devices, there is none
            self.finish(None if success is None else bool(success))

    def _begin(self, first: Transition, seed: int | None) -> None:
        assert self._next is not None
        name, instruction = self._next
        episode = self._writer.episode(name, seed=seed, instruction=instruction)
        self._episode = BackgroundEpisode(episode) if self._is_background else episode
        self._next = None
        # A dataset that is closed first ends the episode as the recorder does.
        episode.end = lambda _: self.close()
        self._broken_off = {}
        poses = {name: pose.tolist() for name, pose in first.objects.items()}
        self._first_facts = {**self._device_facts(), **({OBJECTS: poses} if poses else {})}
        self._last_time = first.time
        self._last_captures = {}
        self._add(first, period=None)

    def _add(self, transition: Transition, period: float | None) -> None:
        assert self._episode is not None
        row: dict[str, Any] = {
            "terminated": transition.terminated,
            "truncated": transition.truncated,
            TIME_MONOTONIC: transition.time,
            TIME_PERIOD: period,
            TIME_COMMAND: transition.command_time,
        }
        if transition.sim_state is not None:
            row[SIMULATED_TIME] = transition.info["time"]
        row.update(_flat(OBSERVATION, transition.observation))
        if transition.action is not None and transition.executed is not None:
            # An action may come in another number type, or as a plain number; it is kept in the form of its space.
            for key, value in _flat(ACTION, transition.action).items():
                dtype, shape = self._forms[key]
                row[key] = np.asarray(value, dtype).reshape(shape)
            row.update(_flat(EXECUTED, transition.executed))
            row["reward"] = transition.reward
        for key, feature in self._notes.items():
            name = key.removeprefix(f"{NOTES}/")
            is_origin = name.rpartition("/")[2] == ORIGIN  # a layer has it, not whoever acts
            row[key] = _noted(feature, (transition.info if is_origin else transition.notes).get(name))
        captures: dict[str, float] = {}
        for key, captured in transition.capture_times.items():
            row[f"time/{key}"] = captured
            if (camera := camera_of_time(key)) is not None:
                captures[camera] = captured
                row[flags_key(camera)] = flags = self._flags(camera, captured, transition.time)
                if flags & FrameFlag.REPEATED:
                    row.update(dict.fromkeys(self._images.get(camera, ())))
        for key, at in transition.device_times.items():
            row[f"{TIME_DEVICE}/{key}"] = at if math.isfinite(at) else None
        self._reconnections = transition.info.get(RECONNECTIONS, {})
        if period is None:
            self._first_reconnections = self._reconnections
        self._last_captures = captures
        self._episode.add(row, transition.sim_state)

    def _flags(self, camera: str, captured: float, now: float) -> int:
        flags = FrameFlag(0)
        if captured == self._last_captures.get(camera):
            flags |= FrameFlag.REPEATED
        if self._stale_after is not None and now - captured > self._stale_after:
            flags |= FrameFlag.STALE
        return int(flags)

    def finish(
        self, success: bool | None, outcome: Mapping[str, Any] | None = None, *, instruction: str | None = None
    ) -> EpisodeRecord:
        """Keep the open episode.

        Args:
            success: Whether the task was done; None if that is not known.
            outcome: Further facts to keep about how it went, as JSON values; where the objects were at the start is
                added as `objects`.
            instruction: Instruction for the robot; None for that of the start.

        Raises:
            WrongOrder: No episode is open.
            DatasetError, CorruptEpisode: The disk is full or fails; the rows stay for `recover`.
        """
        if self._episode is None and self._take is not None:
            raise WrongOrder(
                f"Take {self._take[0]!r} has no observation yet; step or reset the environment, or discard it."
            )
        if self._episode is None:
            raise WrongOrder("There is no open episode to finish; start a take, or reset the environment first.")
        begun = self._first_reconnections
        again = {key: n for key, total in self._reconnections.items() if (n := total - begun.get(key, 0))}
        breaks = {RECONNECTIONS: again} if again else {}
        facts = {**self._first_facts, **breaks, **self._broken_off, **(outcome or {})}
        take = self._take
        try:
            record = self._episode.finish(success, facts, instruction=instruction)
        finally:
            self._forget_closed()
        self._last_take = take
        return record

    @contextmanager
    def discard_on_error(self) -> Generator[None]:
        """Drop the open episode when the block raises: for programs that can make the same episode again."""
        try:
            yield
        except BaseException:
            self._broken_off = {}
            self._let_go()
            raise

    def discard(self) -> None:
        """Drop the open episode with all its rows, and the take under way, if there is one."""
        self._drop()
        if self._take is not None:
            self.forget_next()
            if self._number is not None and self._take[0] == f"{self._number - 1:06d}":
                self._number -= 1
        self._take = None

    def _drop(self) -> None:
        if self._episode is not None:
            episode, self._episode = self._episode, None
            episode.discard()

    def on_end(self, end: str, reasons: Mapping[str, str]) -> None:
        """Store in the open episode why it was aborted; it takes no more rows."""
        if self._episode is not None:
            self._broken_off = {END: end, REASONS: dict(reasons)}

    def close(self) -> None:
        """Keep the open episode without a verdict; `outcome["end"]` has the reason for its end."""
        if self._episode is not None and not self._broken_off:
            self._broken_off = {END: "closed"}
        self._let_go()

    def _let_go(self) -> None:
        """Keep the open episode if it was broken off, and drop it otherwise."""
        self._forget_closed()
        if self._episode is not None and self._broken_off and self._episode.rows:
            self.finish(None)
        if self._episode is not None:
            self._take = None
        self._drop()

    def _forget_closed(self) -> None:
        """Let go of an episode that is no longer open.

        The rows of one that a failing disk has aborted stay for `recover`; one whose `finish` was interrupted may be
        finished all the same.
        """
        if self._episode is not None and self._episode.state != "open":
            self._episode = self._take = None


def _noted(feature: Feature, given: Any) -> NDArray[Any]:
    """Return a note as a dataset has it.

    Raises:
        InvalidSetup: It has another form than the dataset's, or is a word that the dataset does not know.
    """
    if feature.words:
        if given is not None and given not in feature.words:
            raise InvalidSetup(f"{feature.key} is {given!r}; valid: {', '.join(feature.words)}, or none.")
        return np.array(0 if given is None else 1 + feature.words.index(given), np.uint8)
    try:
        return np.broadcast_to(np.asarray(np.nan if given is None else given, np.float64), feature.shape)
    except ValueError as err:
        valid = f"{feature.size} numbers" if feature.shape else "a number"
        raise InvalidSetup(f"{feature.key} is {given!r}; valid is {valid}. {err}") from err


def _flat(prefix: str, values: Mapping[str, Any]) -> dict[str, NDArray[Any]]:
    flat: dict[str, NDArray[Any]] = {}
    for key, value in values.items():
        if isinstance(value, Mapping):
            flat.update(_flat(f"{prefix}/{key}", value))
        elif not is_derived(prefix, key):
            flat[f"{prefix}/{key}"] = value
    return flat
