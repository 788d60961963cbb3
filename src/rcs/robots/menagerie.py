"""Where the detailed meshes of a robot are in the collection `mujoco-menagerie`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from rcs.robots.mount import Mount


@dataclass(frozen=True, kw_only=True)
class MenagerieBody:
    """Where the detailed visuals of one body come from."""

    body: str
    """Body of the built-in model; its visual geoms are exchanged."""
    source: str
    """Body of the collection's model that carries the meshes."""
    source_in_body: Mount = field(default_factory=Mount)
    """Pose of the source's body frame in the frame of the built-in body."""


@dataclass(frozen=True, kw_only=True)
class MenagerieVisuals:
    """The model of `mujoco-menagerie` that has detailed meshes of a robot."""

    model: str
    """Name of the model in the collection, such as `franka_fr3`."""
    entry: str
    """Entry point of the model: its XML file without ending."""
    bodies: tuple[MenagerieBody, ...]
    """Where the meshes go. A body may be named more than once; one that is not named keeps its primitives."""

    @staticmethod
    def of(model: str, entry: str, bodies: Mapping[str, str]) -> MenagerieVisuals:
        """Return visuals whose body frames agree: `bodies` has the source by the name of the built-in body."""
        return MenagerieVisuals(
            model=model,
            entry=entry,
            bodies=tuple(MenagerieBody(body=body, source=source) for body, source in bodies.items()),
        )
