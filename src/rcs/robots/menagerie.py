"""The detailed meshes of a robot in the collection `mujoco-menagerie`."""

from __future__ import annotations

from collections.abc import Mapping

from rcs_data.record import Record

from rcs.robots.mount import Mount


class MenagerieBody(Record):
    """The source of one body's detailed visuals."""

    body: str
    """Body of the built-in model whose visual geoms are replaced."""
    source: str
    """Body of the collection's model that carries the meshes."""
    source_in_body: Mount = Mount()
    """Pose of the source's body frame in the frame of the built-in body."""


class MenagerieVisuals(Record):
    """The model of `mujoco-menagerie` with detailed meshes of a robot."""

    model: str
    """Name of the model in the collection, such as `franka_fr3`."""
    entry: str
    """Entry point of the model: its XML file without ending."""
    bodies: tuple[MenagerieBody, ...]
    """Where the meshes go. A body may occur more than once; others keep their primitives."""

    @staticmethod
    def of(model: str, entry: str, bodies: Mapping[str, str]) -> MenagerieVisuals:
        """Return visuals whose body frames agree; `bodies` maps built-in bodies to their sources."""
        return MenagerieVisuals(
            model=model,
            entry=entry,
            bodies=tuple(MenagerieBody(body=body, source=source) for body, source in bodies.items()),
        )
