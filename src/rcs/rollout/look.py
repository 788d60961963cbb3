"""The look of a replay's frames: changes to the recorded one."""

from __future__ import annotations

import sys
import zlib
from collections.abc import Collection
from dataclasses import dataclass, replace
from typing import Any

from rcs_data import Dataset, DatasetInfo
from rcs_data.feature import Colour
from rcs_data.info import MERGED

from rcs.envs.assemble import assemble
from rcs.envs.env import Env
from rcs.envs.episode_random import EpisodeRandom
from rcs.envs.observers.recorder import dataset_info
from rcs.envs.parts import Parts
from rcs.envs.setup import Setup
from rcs.envs.variation.randomiser import Randomiser
from rcs.errors import InvalidSetup
from rcs.setups.make import resolve
from rcs.sim.camera import Quality
from rcs.sim.detail import Assets
from rcs.sim.randomisation import Randomisation
from rcs.sim.world import Copies

NONE = "none"
"""Stands for no cameras."""
LOOKS = (
    "light_intensity", "light_direction", "light_position", "table_colour", "object_colour", "room_colour", "textures",
    "camera_translation", "camera_rotation", "field_of_view",
)  # fmt: skip
"""Fields of a randomisation that change only pictures."""
KEPT = (
    "image_size", "camera_fps", "depth", "segmentation", "render_quality", "assets", "camera_noise", "calibration",
)  # fmt: skip
"""Fields of a look that are those of a setup."""
RECORDED = "recorded"
"""Key in a dataset's setup: the setup that its states are from, if its frames were drawn with another one."""


@dataclass(frozen=True, kw_only=True)
class Look:
    """How to draw frames; None keeps the recorded value."""

    cameras: tuple[str, ...] | None = None
    """Cameras to draw; `none` for none."""
    image_size: int | None = None
    """Width and height of every frame [px]."""
    camera_fps: float | None = None
    """Frames per second of all cameras; one slower than the recording repeats its last frame."""
    depth: bool | None = None
    """Whether frames carry depth."""
    segmentation: bool | None = None
    """Whether frames say which instance and which geom each pixel shows."""
    render_quality: Quality | None = None
    """`full` draws shadows, reflections and smooth edges; without a GPU, a frame takes some fifty times longer."""
    assets: Assets | None = None
    """Robots of primitives (`builtin`) or with the meshes of MuJoCo Menagerie."""
    camera_noise: bool | None = None
    """Whether frames have the noise of real cameras."""
    calibration: str | None = None
    """Calibration file with poses and intrinsics of cameras."""
    randomise: bool = False
    """Randomise lights, colours, textures and camera poses in every episode."""
    looks_seed: int = 0
    """Same seed, same looks; different seeds make variants of a dataset."""
    jpeg_quality: int | None = None
    """JPEG quality of colour frames, 1 to 100."""

    def apply(self, setup: Setup) -> Setup:
        """Return a setup with this look.

        Raises:
            InvalidSetup: A value is not valid.
        """
        changes: dict[str, Any] = {name: getattr(self, name) for name in KEPT if getattr(self, name) is not None}
        if "image_size" in changes:
            changes["image_size"] = (self.image_size, self.image_size)
            changes.update(camera_sizes={}, camera_mode=None)
        if self.cameras is not None:
            changes["cameras"] = () if self.cameras in ((), (NONE,)) else self.cameras
            shown = changes["cameras"]
            changes.setdefault("camera_sizes", {n: size for n, size in setup.camera_sizes.items() if n in shown})
            if isinstance(setup.camera_fps, tuple) and self.camera_fps is None:
                changes["camera_fps"] = {
                    name: rate for name, rate in setup.camera_fps if name in changes["cameras"]
                } or None
        if self.randomise:
            before, default = setup.randomisation or Randomisation.off(), Randomisation()
            changes["randomisation"] = replace(before, **{name: getattr(default, name) for name in LOOKS})
        return replace(setup, **changes)


@dataclass(frozen=True, kw_only=True)
class Stage:
    """The recorded scene, seen by the same or other cameras.

    Cameras have mass and visible housings that collide. The scene therefore keeps all recorded cameras, whichever are
    drawn.
    """

    setup: Setup
    """The setup of the frames."""
    mounted: tuple[str, ...]
    """All cameras of the scene."""
    looks: Look
    """How frames are drawn."""

    @staticmethod
    def of(physics: Setup, setup: Setup, look: Look) -> Stage:
        """Return the stage for a look at a recording.

        Args:
            physics: The setup of the recording's states.
            setup: The setup of its frames, with any changes.
            look: Changes to the frames' look.
        """
        seen = look.apply(setup)
        return Stage(setup=seen, mounted=tuple(dict.fromkeys((*physics.cameras, *seen.cameras))), looks=look)

    @property
    def scene(self) -> Setup:
        """The setup of the whole scene."""
        return replace(self.setup, cameras=self.mounted)

    def env(self) -> tuple[Env, NewLooks | None]:
        """Make the environment, and the randomiser of its looks; None if they are as recorded."""
        parts = resolve(self.scene)
        env = assemble(parts, drawn=self.setup.cameras)
        if not self.looks.randomise:
            return env, None
        looks = NewLooks(env, parts, self.looks.looks_seed)
        env.scenario.add_randomiser(looks)
        return env, looks

    def info(self, env: Env, recorded: DatasetInfo, physics: Setup | None = None) -> DatasetInfo:
        """Return the info of a dataset of this stage that is derived from another one.

        Args:
            env: The environment.
            recorded: The info of the other.
            physics: The setup that its states are from; None for this stage.
        """
        colours: list[Colour] = [feature.colour for feature in recorded.features if feature.colour is not None]
        first = colours[0] if colours else "jpeg"
        info = dataset_info(
            env,
            colour="lossless" if "lossless" in colours else first,
            jpeg_quality=self.looks.jpeg_quality or recorded.jpeg_quality,
        )
        setup, origin = self.setup.to_json(), self.scene if physics is None else physics
        if origin != self.setup:
            setup[RECORDED] = origin.to_json()
        instruction = recorded.instruction or info.instruction
        return replace(info, setup=setup, instruction=instruction, jpeg_subsampling=recorded.jpeg_subsampling)


class NewLooks(Randomiser):
    """Draws the looks of episodes from its own seed and the episodes' ids, independent of the reset's seed."""

    def __init__(self, env: Env, parts: Parts, seed: int) -> None:
        """Take the nominal looks of an environment that has not been reset yet."""
        ranges = parts.setup.randomisation
        assert ranges is not None
        looks = Randomisation.off(**{name: getattr(ranges, name) for name in LOOKS})
        super().__init__(
            env.scenario.world, looks, objects=parts.task.objects(), robots=parts.robots, cameras=parts.cameras
        )
        self._seed = seed
        self.episode_id = ""
        """The id of the next episode."""

    def begin(self, draws: EpisodeRandom, copies: Copies = None) -> None:
        """Draw and write the looks of an episode."""
        super().begin(EpisodeRandom(self._seed, zlib.crc32(self.episode_id.encode())), copies)


def varied(env: Env) -> dict[str, Any]:
    """Return the outcome's entry about the randomisation of the present episode."""
    drawn = {field: values.tolist() for field, values in env.scenario.randomisation.items()}
    return {"randomisation": drawn} if drawn else {}


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
    """Return the setup that a dataset's states come from; it differs from `setup_of` where frames were drawn later.

    Args:
        dataset: The dataset.
        trust: Modules that may be imported because the setup names them.

    Raises:
        InvalidSetup: See `setup_of`.
    """
    recorded = dataset.info.setup.get(RECORDED)
    return setup_of(dataset, trust=trust) if recorded is None else _parse(dataset, recorded, trust)


def _parse(dataset: Dataset, values: Any, trust: Collection[str]) -> Setup:
    """Read a setup. A dataset from elsewhere must not run code by naming a module, whatever the field."""
    require_trusted(values, f"The setup of {dataset.path}", trust)
    return Setup.from_json(values)


def require_trusted(values: Any, whose: str, trust: Collection[str] = ()) -> None:
    """Check that JSON values name no class whose module would have to be imported first, and so would run its code.

    Args:
        values: The values.
        whose: What they are, at the start of the message.
        trust: Modules that may be imported.

    Raises:
        InvalidSetup: They do.
    """
    for module in sorted(_modules(values)):
        if module not in sys.modules and module not in trust:
            raise InvalidSetup(
                f"{whose} names a class of the module {module!r}, which is not imported. Importing "
                f"it runs its code; if you trust it, import it first, or give --trust {module}."
            )


def _modules(value: Any) -> set[str]:
    """Return the modules of all `module:Class` in a JSON value."""
    if isinstance(value, dict | list):
        return set().union(*map(_modules, value.values() if isinstance(value, dict) else value))
    module, colon, name = value.partition(":") if isinstance(value, str) else ("", "", "")
    is_reference = colon and all(part.isidentifier() for part in (*module.split("."), *name.split(".")))
    return {module} if is_reference else set()


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


def require_states(dataset: Dataset) -> None:
    """Check that a dataset has states of a simulation.

    Raises:
        InvalidSetup: It has none.
    """
    if dataset.info.sim_state_size is None:
        raise InvalidSetup(
            f"The dataset in {dataset.path} has no simulation states, which this replay needs. "
            "For recordings of real robots, use `--kind states`."
        )
