"""Randomises the models and starts of all copies at once at the start of episodes.

Draws always apply to nominal values, so that an episode does not depend on the one before. They depend only on seed and
episode, in streams separate from the task's: replays repeat them, and they do not change how a task starts.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from rcs.envs.episode_random import EpisodeRandom
from rcs.envs.variation.looks import add_cameras, add_lights, add_surfaces
from rcs.envs.variation.objects import add_friction, add_objects
from rcs.envs.variation.robots import add_drives, add_latency, add_table
from rcs.envs.variation.start import VariedStart
from rcs.envs.variation.variation import Values, Variation
from rcs.sim.model_rows import ObjectParts
from rcs.sim.randomisation import Randomisation
from rcs.sim.robot import SimRobot
from rcs.sim.scene import CameraPlacement, RobotPlacement
from rcs.sim.world import Copies, World


class Randomiser:
    """Varies one world from episode to episode."""

    memory = ("_vary",)

    def __init__(
        self,
        world: World,
        ranges: Randomisation,
        *,
        objects: Sequence[str] = (),
        robots: Sequence[RobotPlacement] = (),
        cameras: Sequence[CameraPlacement] = (),
    ) -> None:
        """Look up what varies, and take its present values as nominal.

        Args:
            world: A world fresh from its model.
            ranges: Ranges of the draws.
            objects: Names of the task's bodies.
            robots: Robots of its scene, which has room for late controls if the latency of actions varies.
            cameras: Cameras of its scene.

        Raises:
            KeyError: An object is not in the model.
        """
        self._vary = vary = Variation(world, ranges)
        # First, since it looks at the nominal model.
        self._start = VariedStart(vary, robots)
        add_lights(vary)
        add_surfaces(vary)
        parts = [ObjectParts(world, name) for name in objects]
        add_objects(vary, parts, objects)
        add_friction(vary, parts, objects)
        add_cameras(vary, cameras)
        add_drives(vary, robots)
        add_table(vary)
        self._latency = add_latency(vary, robots)
        names = [camera.name for camera in cameras]
        vary.enable("frame_latency", (len(names),), names)

    @property
    def ranges(self) -> Randomisation:
        """The ranges of the draws."""
        return self._vary.ranges

    @property
    def names(self) -> dict[str, tuple[str, ...]]:
        """What the rows of each field's values belong to, in order."""
        return self._vary.names

    @property
    def values(self) -> dict[str, Values]:
        """The draws of the present episodes, by field of `Randomisation`: (*leading, ...), replaced as a whole."""
        return self._vary.values

    def by_name(self, field: str, names: Sequence[str]) -> dict[str, Values]:
        """Return a field's values by the names that they belong to, (*leading,) each; zeros if it does not vary."""
        values, known = self._vary.values.get(field), self.names.get(field, ())
        if values is None:
            return dict.fromkeys(names, np.zeros(self._vary.world.leading))
        return {name: values[..., known.index(name)] for name in names}

    def begin_too(self, begin: Callable[[EpisodeRandom, Copies], None]) -> None:
        """Have something else started with the streams of each episode; it takes a branch of them."""
        self._vary.begin_too(begin)

    def begin(self, draws: EpisodeRandom, copies: Copies = None) -> None:
        """Draw and write the values of some copies' next episodes.

        Args:
            draws: Random numbers for exactly these copies; they are not advanced.
            copies: Which copies; None for all.
        """
        self._vary.begin(draws, copies)

    def place(self, robots: Sequence[SimRobot], copies: Copies = None) -> None:
        """Put the robots of some copies where their present episodes start, once the world is reset."""
        self._start.place(robots, copies)
        self.settle(copies)

    def settle(self, copies: Copies = None) -> None:
        """Make the present controls of some copies those that were always given, after writing them."""
        if self._latency is not None:
            self._latency.settle(copies)
