"""The setup of a recorded dataset, read so that a dataset never decides which code is imported."""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Collection
from dataclasses import replace
from typing import Any

from rcs_data import Dataset
from rcs_data.files.info import MERGED

from rcs.envs.setup import Setup
from rcs.errors import InvalidSetup
from rcs.sim.randomisation import Randomisation

RECORDED = "recorded"
"""Key in a dataset's setup: the setup of its states, if its frames were rendered with another one."""
SEEN = ("cameras", "render_quality", "assets", "randomisation")
"""Fields of a setup that change only frames; of a randomisation, those in `VISUAL`."""
VISUAL = (
    "light_intensity", "light_direction", "light_position", "table_colour", "object_colour", "room_colour", "textures",
    "camera_translation", "camera_rotation", "field_of_view",
)  # fmt: skip
"""Fields of a randomisation that change only frames."""


def setup_of(dataset: Dataset, *, trust: Collection[str] = (), task: str | None = None) -> Setup:
    """Return the setup of a dataset's observations: an environment of it gives frames like the recorded ones.

    Args:
        dataset: The dataset.
        trust: Modules that may be imported because the setup names them.
        task: Replaces the recorded task; its module is trusted.

    Raises:
        InvalidSetup: The dataset has no setup, one of another version, several that were merged, or one that names a
            module that is neither imported nor trusted.
    """
    setup = dataset.info.setup
    for name, part in dataset.info.origin.get(MERGED, {}).items():
        different = [key for key in part.get("setup", {}) if key not in setup]
        if different:
            raise InvalidSetup(
                f"{dataset.path} was merged from datasets whose setups differ in {', '.join(different)} ({name} is one "
                "of them). Split it and replay each part."
            )
    values = {key: value for key, value in setup.items() if key != RECORDED}
    if task is not None:
        values, trust = {**values, "task": task}, {*trust, *_modules(task)}
    return _parse(dataset, values, trust)


def physics_of(dataset: Dataset, *, trust: Collection[str] = ()) -> Setup:
    """Return the setup of a dataset's states; it differs from `setup_of` if the frames were rendered later.

    Args:
        dataset: The dataset.
        trust: Modules that may be imported because the setup names them.

    Raises:
        InvalidSetup: See `setup_of`.
    """
    recorded = dataset.info.setup.get(RECORDED)
    return setup_of(dataset, trust=trust) if recorded is None else _parse(dataset, recorded, trust)


def seen_as(recorded: Setup, wanted: Setup | None, looks_seed: int | None = None) -> Setup:
    """Return a recorded setup with the frames of another one: its cameras, quality, assets and visual randomisation.

    Args:
        recorded: The recorded setup.
        wanted: The other setup; None for the recorded one.
        looks_seed: Seed of the appearance, which is randomised even if `wanted` has no randomisation; None for the
            recorded appearance.

    Raises:
        InvalidSetup: They differ in something else.
    """
    wanted = wanted or recorded
    names = [own.name for own in dataclasses.fields(Setup)]  # pyright: ignore[reportArgumentType]
    different = [n for n in names if n not in SEEN and getattr(wanted, n) != getattr(recorded, n)]
    if different:
        raise InvalidSetup(
            f"The setup differs from the recorded one in {', '.join(different)}; recorded actions and states are seen "
            f"anew with other {', '.join(SEEN)}, and all else as recorded."
        )
    ranges = Randomisation() if looks_seed is not None and wanted.randomisation is None else wanted.randomisation
    if ranges != recorded.randomisation:
        before, after = recorded.randomisation or Randomisation.off(), ranges or Randomisation.off()
        ranges = replace(before, **{name: getattr(after, name) for name in VISUAL})
    return replace(wanted, randomisation=ranges)


def require_trusted(values: Any, source: str, trust: Collection[str] = ()) -> None:
    """Check that JSON values name no class whose module would have to be imported first, which would run its code.

    Args:
        values: The values.
        source: Where they are from, at the start of the message.
        trust: Modules that may be imported.

    Raises:
        InvalidSetup: They name such a class.
    """
    for module in sorted(_modules(values)):
        if module not in sys.modules and module not in trust:
            raise InvalidSetup(
                f"{source} names a class of the module {module!r}, which is not imported. Importing "
                f"it runs its code; if you trust it, import it first, or give --trust {module}."
            )


def require_states(dataset: Dataset) -> None:
    """Check that a dataset has simulation states.

    Raises:
        InvalidSetup: It has none.
    """
    if dataset.info.sim_state_size is None:
        raise InvalidSetup(
            f"The dataset in {dataset.path} has no simulation states, which this replay needs. "
            "For recordings of real robots, use `--kind states`."
        )


def require_rate(dataset: Dataset, physics: Setup) -> None:
    """Check that a dataset still has a row for every control step, so that its actions can be executed.

    Raises:
        InvalidSetup: The dataset was resampled.
    """
    recorded = physics.frequency
    if dataset.info.frequency != recorded:
        raise InvalidSetup(
            f"The dataset in {dataset.path} was recorded at {recorded:g} Hz and is now at "
            f"{dataset.info.frequency:g} Hz, so its actions cannot be executed step by step. Use `--kind states`, or "
            "replay the original dataset."
        )


def _parse(dataset: Dataset, values: Any, trust: Collection[str]) -> Setup:
    require_trusted(values, f"The setup of {dataset.path}", trust)
    return Setup.from_json(values)


def _modules(value: Any) -> set[str]:
    """Return the modules of all `module:Class` in a JSON value, whatever the field."""
    if isinstance(value, dict | list):
        return set().union(*map(_modules, value.values() if isinstance(value, dict) else value))
    module, colon, name = value.partition(":") if isinstance(value, str) else ("", "", "")
    is_reference = colon and all(part.isidentifier() for part in (*module.split("."), *name.split(".")))
    return {module} if is_reference else set()
