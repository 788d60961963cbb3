"""Randomises the models and starts of all copies at once at the start of episodes.

Draws always apply to nominal values, so that an episode does not depend on the one before. They depend only on seed and
episode, in streams separate from the task's: replays repeat them, and they do not change how a task starts.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rcs.envs.episode_random import EpisodeRandom
from rcs.envs.variation.robots import VariedStart, add_drives, add_latency, add_table
from rcs.envs.variation.scene import add_cameras, add_friction, add_lights, add_objects, add_surfaces
from rcs.sim.model_fields import FieldRange, bounds_of, find_rows
from rcs.sim.model_rows import ModelRows, ObjectParts, owners
from rcs.sim.randomisation import Randomisation
from rcs.sim.robot import SimRobot
from rcs.sim.scene import CameraPlacement, RobotPlacement
from rcs.sim.world import Copies, World

Values = NDArray[np.float64]
Write = Callable[[dict[str, Values], Copies], None]
"""Writes the draws, by field, for some copies; None for all."""

UNIT_LENGTH = ("quat", "_axis", "_dir")
"""Ends of the names of fields whose rows have a length of one."""
WITHOUT_CONSTANTS = ("geom", "light", "mat", "pair")
"""Kinds of elements from which MuJoCo derives no constants."""


class Randomiser:
    """Varies one world from episode to episode: draws each field from a stream of its own and has it written."""

    memory = ("values",)

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
            InvalidSetup: A field range names nothing in the model.
        """
        self.world = world
        self.ranges = ranges
        self.changes_constants = False
        """Compute the constants that MuJoCo derives, such as from masses, after writing."""
        self.names: dict[str, tuple[str, ...]] = {}
        """Names of the elements that the rows of each field's values belong to, in order."""
        self.values: dict[str, Values] = {}
        """The draws of the present episodes, by field of `Randomisation`: (*leading, ...), replaced as a whole."""
        self.written: dict[str, set[int]] = {}
        """Rows that are written in every episode, by field of the model."""
        self._bounds: dict[str, tuple[Values, Values]] = {}
        self._finishes: dict[str, Callable[[Values], Values]] = {}
        self._writes: list[Write] = []
        self._begins: list[Callable[[EpisodeRandom, Copies], None]] = []
        # First, since it looks at the nominal model.
        self._start = VariedStart(self, robots)
        add_lights(self)
        add_surfaces(self)
        parts = [ObjectParts(world, name) for name in objects]
        add_objects(self, parts, objects)
        add_friction(self, parts, objects)
        add_cameras(self, cameras)
        add_drives(self, robots)
        add_table(self)
        self._latency = add_latency(self, robots)
        self.enable("frame_latency", [camera.name for camera in cameras])
        for wanted in ranges.fields:
            _add_field(self, wanted)

    def enable(
        self,
        field: str,
        names: Sequence[str],
        *,
        each: tuple[int, ...] = (),
        bounds: tuple[ArrayLike, ArrayLike] | None = None,
        finish: Callable[[Values], Values] | None = None,
    ) -> bool:
        """Enable a field if its range has a width and there is something to vary; return whether.

        Args:
            field: A field of `Randomisation`, or the key of a field range.
            names: Names of the elements that the rows of its values belong to.
            each: Shape of the values of one element.
            bounds: Bounds of the uniform draws; None for those of the field's range, in the shape of its values.
            finish: Makes the values, (*leading, elements, *each), from the draws; None if they are the values.
        """
        shape = (len(names), *each)
        if 0 in shape or (field in Randomisation.names() and not self.ranges.varies(field)):
            return False
        low, high = self.ranges.bounds(field) if bounds is None else bounds
        drawn = shape if bounds is None else np.broadcast_shapes(np.shape(low), np.shape(high))
        self._bounds[field] = np.full(drawn, low), np.full(drawn, high)
        if finish is not None:
            self._finishes[field] = finish
        self.names[field] = tuple(names)
        self.values[field] = np.zeros(self.world.leading + shape)
        return True

    def rows(self, field: str, rows: ArrayLike) -> ModelRows:
        """Return rows of a field of the model, which are written in every episode from now on."""
        found = ModelRows(self.world, field, rows)
        self.written.setdefault(field, set()).update(map(int, found.rows))
        return found

    def write_with(self, write: Write) -> None:
        """Write the draws with a function, too."""
        self._writes.append(write)

    def scale(self, field: str, names: Sequence[str], rows: Mapping[str, Sequence[ArrayLike]]) -> bool:
        """Enable a field of factors and have them multiply rows of the model; return whether it varies.

        Args:
            field: A field of `Randomisation`.
            names: Names of the elements, each with a factor of its own.
            rows: The rows of each element, by field of the model.
        """
        if not self.enable(field, names):
            return False
        groups = {name: [np.asarray(one, np.intp) for one in own] for name, own in rows.items()}
        scaled = [
            (self.rows(name, np.concatenate(own)), owners(own)) for name, own in groups.items() if sum(map(len, own))
        ]

        def write(drawn: dict[str, Values], copies: Copies) -> None:
            for values, owner in scaled:
                values.scale(drawn[field][..., owner], copies)

        self.write_with(write)
        return True

    def by_name(self, field: str, names: Sequence[str]) -> dict[str, Values]:
        """Return a field's values by the names that they belong to, (*leading,) each; zeros if it does not vary."""
        values, known = self.values.get(field), self.names.get(field, ())
        if values is None:
            return dict.fromkeys(names, np.zeros(self.world.leading))
        return {name: values[..., known.index(name)] for name in names}

    def begin_too(self, begin: Callable[[EpisodeRandom, Copies], None]) -> None:
        """Call a function with the streams of each episode, of which it takes a branch."""
        self._begins.append(begin)

    def begin(self, draws: EpisodeRandom, copies: Copies = None) -> None:
        """Draw and write the values of some copies' next episodes.

        Args:
            draws: Random numbers for exactly these copies; they are not advanced.
            copies: Which copies; None for all.
        """
        streams = draws.branch("randomisation")
        for begin in self._begins:
            begin(streams, copies)
        if not self._bounds:
            return
        drawn: dict[str, Values] = {}
        for field, (low, high) in self._bounds.items():
            uniform = streams.branch(field).uniform(low, high)
            finish = self._finishes.get(field)
            drawn[field] = uniform if finish is None else finish(uniform)
        for write in self._writes:
            write(drawn, copies)
        if self.changes_constants:
            self.world.update_constants(copies)
        if copies is None:
            self.values = drawn
        else:
            self.values = {field: values.copy() for field, values in self.values.items()}
            for field, values in drawn.items():
                self.values[field][copies] = values

    def place(self, robots: Sequence[SimRobot], copies: Copies = None) -> None:
        """Put the robots of some copies where their present episodes start, once the world is reset."""
        self._start.place(robots, copies)
        self.settle(copies)

    def settle(self, copies: Copies = None) -> None:
        """Fill the history of some copies with their present controls, after writing them."""
        if self._latency is not None:
            self._latency.settle(copies)


def _add_field(vary: Randomiser, wanted: FieldRange) -> None:
    """Vary a field of the model by its name in MuJoCo."""
    model = vary.world.model
    found, names = find_rows(model, wanted)
    # Values written before in an episode are the base of this range.
    is_base = np.isin(found, list(vary.written.get(wanted.field, ())))
    rows = vary.rows(wanted.field, found)
    nominal = rows.nominal.reshape(len(found), -1)
    columns = np.arange(nominal.shape[1]) if wanted.axes is None else np.array(wanted.axes)
    owners = ["all"] if wanted.per == "all" else names
    each = (len(columns),) if wanted.per == "value" and rows.nominal.ndim > 1 else ()
    shape = (len(owners), *each)
    if not vary.enable(wanted.key, owners, each=each, bounds=(np.full(shape, wanted.low), np.full(shape, wanted.high))):
        return
    vary.changes_constants |= wanted.kind not in WITHOUT_CONSTANTS
    bounds = [vary.rows(name, found) for name in ("geom_rbound", "geom_aabb") if wanted.field == "geom_size"]

    def write(drawn: dict[str, Values], copies: Copies) -> None:
        draws = drawn[wanted.key] if each else drawn[wanted.key][..., None]
        values = np.array(rows.read(copies), np.float64).reshape(*draws.shape[:-2], *nominal.shape)
        values[..., ~is_base, :] = nominal[~is_base]
        chosen = values[..., columns]
        if wanted.operation == "scale":
            chosen *= draws
        elif wanted.operation == "add":
            chosen += draws
        else:
            chosen[...] = draws
        values[..., columns] = chosen
        if wanted.field.endswith(UNIT_LENGTH):
            values /= np.sqrt((values * values).sum(axis=-1, keepdims=True))
        elif wanted.field.endswith("rgba"):
            np.clip(values, 0.0, 1.0, out=values)
        rows.write(values.reshape(*draws.shape[:-2], *rows.nominal.shape), copies)
        for own, bound in zip(bounds, bounds_of(model.geom_type[found], values) if bounds else (), strict=True):
            own.write(bound, copies)

    vary.write_with(write)
