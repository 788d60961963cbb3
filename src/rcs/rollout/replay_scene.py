"""The recorded scene of a replay, and the appearance of the frames that are rendered of it."""

from __future__ import annotations

import zlib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from rcs_data import DatasetInfo
from rcs_data.feature import Colour

from rcs.envs.assemble import assemble
from rcs.envs.env import Env
from rcs.envs.episode_random import EpisodeRandom
from rcs.envs.observers.dataset_info import dataset_info
from rcs.envs.parts import Parts
from rcs.envs.setup import Setup
from rcs.envs.variation.randomiser import Randomiser
from rcs.rollout.recorded_setup import RECORDED
from rcs.setups.make import resolve
from rcs.sim.camera import Quality
from rcs.sim.detail import Assets
from rcs.sim.randomisation import Randomisation
from rcs.sim.world import Copies

NONE = "none"
"""Stands for no cameras."""
VISUAL = (
    "light_intensity", "light_direction", "light_position", "table_colour", "object_colour", "room_colour", "textures",
    "camera_translation", "camera_rotation", "field_of_view",
)  # fmt: skip
"""Fields of a randomisation that change only frames."""
OF_CAMERAS = {
    "image_size": "image_size", "camera_fps": "fps", "depth": "depth", "segmentation": "segmentation",
    "camera_noise": "noise", "calibration": "calibration",
}  # fmt: skip
"""Fields of an appearance, and those of `Cameras` that they change."""


@dataclass(frozen=True, kw_only=True)
class Appearance:
    """Changes to the frames of a recording; None keeps the recorded value."""

    cameras: tuple[str, ...] | None = None
    """Cameras to render; `none` for none."""
    image_size: int | None = None
    """Width and height of every frame [px]."""
    camera_fps: float | None = None
    """Frames per second of all cameras; one slower than the recording repeats its last frame."""
    depth: bool | None = None
    """Render depth."""
    segmentation: bool | None = None
    """Render the instance and the geom of each pixel."""
    render_quality: Quality | None = None
    """`full` renders shadows, reflections and smooth edges; without a GPU, a frame takes some fifty times longer."""
    assets: Assets | None = None
    """Robots of primitives (`builtin`) or with the meshes of MuJoCo Menagerie."""
    camera_noise: bool | None = None
    """Add the noise of real cameras to the frames."""
    calibration: str | None = None
    """Calibration file with poses and intrinsics of cameras."""
    randomise: bool = False
    """Randomise lights, colours, textures and camera poses in every episode."""
    looks_seed: int = 0
    """Seed of these; different seeds make variants of a dataset."""
    jpeg_quality: int | None = None
    """JPEG quality of colour frames, 1 to 100."""

    def apply(self, setup: Setup) -> Setup:
        """Return a setup with this appearance.

        Raises:
            InvalidSetup: A value is not valid.
        """
        cameras: dict[str, Any] = {
            name: getattr(self, own) for own, name in OF_CAMERAS.items() if getattr(self, own) is not None
        }
        if "image_size" in cameras:
            cameras["mode"] = None
        if self.cameras is not None:
            shown = () if self.cameras in ((), (NONE,)) else self.cameras
            by_name = {name: getattr(setup.cameras, name) for name in ("image_size", "fps", "mounts")}
            kept = {
                name: {camera: value for camera, value in values.items() if camera in shown}
                for name, values in by_name.items()
                if isinstance(values, Mapping)
            }
            cameras = {"names": shown, **kept, **cameras}
        changes: dict[str, Any] = {"cameras": replace(setup.cameras, **cameras)}
        changes |= {name: own for name in ("render_quality", "assets") if (own := getattr(self, name)) is not None}
        if self.randomise:
            before, default = setup.randomisation or Randomisation.off(), Randomisation()
            changes["randomisation"] = replace(before, **{name: getattr(default, name) for name in VISUAL})
        return replace(setup, **changes)


@dataclass(frozen=True, kw_only=True)
class ReplayScene:
    """The recorded scene, seen by the same or other cameras.

    Cameras have mass and housings that collide. The scene therefore keeps all recorded cameras, rendered or not.
    """

    physics: Setup
    """The setup of the recorded states."""
    frames: Setup
    """The setup of the recorded frames."""
    appearance: Appearance = field(default_factory=Appearance)
    """Changes to the frames."""

    @property
    def setup(self) -> Setup:
        """The setup of the new frames."""
        return self.appearance.apply(self.frames)

    @property
    def whole(self) -> Setup:
        """The setup of the new frames, with all cameras of the scene."""
        setup = self.setup
        names = tuple(dict.fromkeys((*self.physics.cameras, *setup.cameras)))
        mounts = {**self.physics.cameras.mounts, **setup.cameras.mounts}
        return replace(setup, cameras=replace(setup.cameras, names=names, mounts=mounts))

    def make(self) -> tuple[Env, NewAppearance | None]:
        """Make the environment, and the randomiser of its appearance; None if that is as recorded."""
        parts = resolve(self.whole)
        env = assemble(parts, drawn=self.setup.cameras.names)
        if not self.appearance.randomise:
            return env, None
        randomiser = NewAppearance(env, parts, self.appearance.looks_seed)
        env.simulation.add_randomiser(randomiser)
        return env, randomiser

    def info(self, env: Env, recorded: DatasetInfo, *, has_recorded_states: bool = False) -> DatasetInfo:
        """Return the info of a dataset of this scene that is derived from another one.

        Args:
            env: The environment.
            recorded: The info of the other.
            has_recorded_states: Whether its states are the recorded ones, not new ones of this scene.
        """
        colours: list[Colour] = [feature.colour for feature in recorded.features if feature.colour is not None]
        colour: Colour = "lossless" if "lossless" in colours else (*colours, "jpeg")[0]
        info = dataset_info(env, colour=colour, jpeg_quality=self.appearance.jpeg_quality or recorded.jpeg_quality)
        setup, physics = self.setup.to_json(), self.physics if has_recorded_states else self.whole
        if physics != self.setup:
            setup[RECORDED] = physics.to_json()
        instruction = recorded.instruction or info.instruction
        return replace(info, setup=setup, instruction=instruction, jpeg_subsampling=recorded.jpeg_subsampling)


class NewAppearance(Randomiser):
    """Draws the appearance of episodes from its own seed and the episodes' ids, whatever the seed of the reset."""

    def __init__(self, env: Env, parts: Parts, seed: int) -> None:
        """Take the nominal appearance of an environment that has not been reset yet."""
        ranges = parts.setup.randomisation
        assert ranges is not None
        visual = Randomisation.off(**{name: getattr(ranges, name) for name in VISUAL})
        super().__init__(
            env.simulation.world, visual, objects=parts.task.objects(), robots=parts.robots, cameras=parts.cameras
        )
        self._seed = seed
        self.episode_id = ""
        """Id of the next episode."""

    def begin(self, draws: EpisodeRandom, copies: Copies = None) -> None:
        """Draw and write the appearance of an episode."""
        super().begin(EpisodeRandom(self._seed, zlib.crc32(self.episode_id.encode())), copies)
