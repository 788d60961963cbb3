"""Record an environment, or every copy of a batch, into a dataset with one call."""

from __future__ import annotations

import itertools
from collections.abc import Generator, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from rcs_data import DatasetWriter
from rcs_data.files.feature import Colour

from rcs.envs.env import Env
from rcs.envs.observer import Note
from rcs.envs.observers.dataset_info import dataset_info
from rcs.envs.observers.recorder import Recorder
from rcs.envs.step.stack import for_all
from rcs.envs.vector import VecEnv


@contextmanager
def record(
    env: Env, out: str | Path, *, colour: Colour = "jpeg", jpeg_quality: int = 95, notes: Sequence[str | Note] = ()
) -> Generator[Recorder]:
    """Record takes that a person starts, judges and discards.

    Args:
        env: The environment; in real time, a thread encodes so that its loop never waits.
        out: The dataset's folder; an existing one is continued.
        colour: Encoding of colour frames.
        jpeg_quality: JPEG quality of colour frames, 1 to 100.
        notes: Notes that `env.note` gives to record; see `dataset_info`.

    Yields:
        The recorder. A take that is open at the end is kept without a verdict.

    Examples:
        >>> import rcs
        >>> env = rcs.make("PickCuboid")
        >>> with rcs.record(env, "takes") as recorder:
        ...     recorder.start(at_reset=True)
        ...     observation, info = env.reset(seed=0)
        ...     recorder.finish(success=True)
    """
    info = dataset_info(env, colour=colour, jpeg_quality=jpeg_quality, notes=notes)
    with DatasetWriter.open(Path(out), info, resume=True) as writer:
        recorder = recorder_of(env, writer)
        env.add_observer(recorder)
        try:
            yield recorder
        finally:
            recorder.close()
            env.remove_observer(recorder)


@contextmanager
def record_all(
    env: Env | VecEnv,
    out: str | Path,
    *,
    colour: Colour = "jpeg",
    jpeg_quality: int = 95,
    notes: Sequence[str | Note] = (),
) -> Generator[None]:
    """Record every episode from reset to end, judged by the task; for a batch, those of all copies at once.

    An episode that a reset cuts short is not kept; one that is open in the end is, without a verdict.

    Args:
        env: The environment, or a batch of copies.
        out: The dataset's folder; an existing one is continued.
        colour: Encoding of colour frames.
        jpeg_quality: JPEG quality of colour frames, 1 to 100.
        notes: As in `record`; a batch has none.

    Examples:
        >>> import rcs
        >>> envs = rcs.make_vec("PickCuboid", copies=24)
        >>> with record_all(envs, "episodes"):
        ...     observations, infos = envs.reset(seed=0)
        ...     observations, *_ = envs.step(envs.action_space.sample())
    """
    info = dataset_info(env, colour=colour, jpeg_quality=jpeg_quality, notes=notes)
    with DatasetWriter.open(Path(out), info, resume=True) as writer:
        taken = writer.taken()
        names = (name for i in itertools.count() if (name := f"{i:06d}") not in taken)
        recorders = [recorder_of(env, writer, names) for _ in range(env.num_envs if isinstance(env, VecEnv) else 1)]
        for copy, recorder in enumerate(recorders):
            if isinstance(env, VecEnv):
                env.add_observer(recorder, copy=copy)
            else:
                env.add_observer(recorder)
        try:
            yield
        finally:
            for recorder in recorders:
                env.remove_observer(recorder)
            for_all([recorder.close for recorder in recorders])


def recorder_of(env: Env | VecEnv, writer: DatasetWriter, names: Iterator[str] | None = None) -> Recorder:
    """Return what records an environment, or one copy of a batch: beside its loop where steps take real time."""
    ages = [port.stale_after for port in env.stack.ports if port.stale_after is not None]
    is_real = isinstance(env, Env) and env.is_real
    return Recorder(
        writer,
        names=names,
        background=is_real,
        stale_after=min(ages, default=None),
        device_facts=lambda: env.stack.device_facts,
    )
