"""Detailed visuals: meshes of the package `mujoco-menagerie` instead of a robot's built-in primitives.

Only visible geoms are replaced. Bodies, joints, sites, inertias, collisions and actuators stay the same, and so do
episodes, bit for bit.
"""

from __future__ import annotations

import importlib
import warnings
from collections.abc import Iterable
from pathlib import Path
from typing import Literal

import mujoco

from rcs.errors import MissingDependency
from rcs.kinematics.chain import mount_frame, quaternion_of
from rcs.robots.description import MenagerieVisuals

Assets = Literal["builtin", "menagerie"]
"""The source of a robot's looks."""

VISUAL_GROUP = 2
"""Group of purely visual geoms in the built-in models."""
LAST_DRAWN_GROUP = 2
"""MuJoCo draws the groups 0 to 2 by default; models of others have visuals in any of them."""


def exchange_visuals(spec: mujoco.MjSpec, parts: Iterable[tuple[str, MenagerieVisuals | None]]) -> bool:
    """Replace the visual geoms of a robot by meshes, of all its parts or none.

    Args:
        spec: Model of the robot, changed in place.
        parts: The prefix of each part's names and the source of its meshes; with None the part keeps its looks.

    Returns:
        False if the meshes are unavailable; a warning then says why and what to do.
    """
    mapped = [(prefix, visuals) for prefix, visuals in parts if visuals is not None]
    wanted = " ".join(visuals.model for _, visuals in mapped)
    try:
        opened = [(prefix, visuals, _open(visuals, wanted)) for prefix, visuals in mapped]
    except MissingDependency as err:
        # Looks do not change physics, so a run without a network goes on with a warning.
        warnings.warn(f"assets='menagerie' shows the built-in visuals: {err}", stacklevel=3)
        return False
    for prefix, visuals, source in opened:
        _exchange(spec, prefix, visuals, source)
    return True


def _open(visuals: MenagerieVisuals, wanted: str) -> mujoco.MjSpec:
    """Read a model of the collection; the package downloads it when it is not on disk.

    Args:
        visuals: Names the model.
        wanted: Names of all models that the robot needs, for the message.

    Raises:
        MissingDependency: The package is not installed, or the model is unavailable or of another version.
    """
    try:
        menagerie = importlib.import_module("mujoco_menagerie")
    except ModuleNotFoundError as err:
        raise MissingDependency(
            "the package mujoco-menagerie is not installed; pip install 'robot-control-stack[menagerie]'."
        ) from err
    try:
        source = mujoco.MjSpec.from_file(str(menagerie.get(visuals.model).xml(visuals.entry)))
    except (menagerie.MenagerieError, OSError, ValueError) as err:
        raise MissingDependency(
            f"{visuals.model} is neither on disk nor could it be downloaded ({type(err).__name__}: {err}). Run "
            f"`mujoco-menagerie prefetch {wanted}` once with a network, or set MENAGERIE_ROOT to a checkout of "
            "mujoco_menagerie."
        ) from err
    lacks = [f"body {body.source}" for body in visuals.bodies if source.body(body.source) is None]
    lacks += [f"file {file}" for file in (_file_of(source, mesh) for mesh in source.meshes) if not file.is_file()]
    if lacks:
        raise MissingDependency(
            f"{visuals.model} of mujoco-menagerie lacks {', '.join(lacks)}; install the version of the package in  "
            "constraints.txt, or a complete checkout of its models."
        )
    return source


def _exchange(spec: mujoco.MjSpec, prefix: str, visuals: MenagerieVisuals, source: mujoco.MjSpec) -> None:
    for name in {body.body for body in visuals.bodies}:
        for geom in spec.body(prefix + name).geoms:
            # Something may refer to a geom with a name.
            if geom.group == VISUAL_GROUP and not geom.name:
                spec.delete(geom)
    names = f"{prefix}{visuals.model}/"
    for body in visuals.bodies:
        target = spec.body(prefix + body.body)
        frame = mount_frame(target, body.source_in_body)
        for geom in source.body(body.source).geoms:
            if geom.group <= LAST_DRAWN_GROUP:
                _add_like(target, geom, spec, source, names).set_frame(frame)


def _add_like(
    target: mujoco.MjsBody, geom: mujoco.MjsGeom, spec: mujoco.MjSpec, source: mujoco.MjSpec, names: str
) -> mujoco.MjsGeom:
    """Add a geom that looks like `geom`, without mass and contacts; `names` is the prefix of meshes and materials."""
    added = target.add_geom(
        type=geom.type,
        pos=geom.pos,
        quat=quaternion_of(geom, source),
        size=geom.size,
        fromto=geom.fromto,
        rgba=geom.rgba,
        group=VISUAL_GROUP,
        contype=0,
        conaffinity=0,
        mass=0.0,
    )
    if geom.meshname:
        added.meshname = _add_mesh(spec, source, source.mesh(geom.meshname), names)
    if geom.material:
        added.material = _add_material(spec, source.material(geom.material), names)
    return added


def _add_mesh(spec: mujoco.MjSpec, source: mujoco.MjSpec, mesh: mujoco.MjsMesh, names: str) -> str:
    name = names + mesh.name
    if spec.mesh(name) is None:
        spec.add_mesh(
            name=name,
            file=str(_file_of(source, mesh)),
            scale=mesh.scale,
            refpos=mesh.refpos,
            refquat=mesh.refquat,
            smoothnormal=mesh.smoothnormal,
        )
    return name


def _add_material(spec: mujoco.MjSpec, material: mujoco.MjsMaterial, names: str) -> str:
    """Add a material without its texture, which none of the mapped models has."""
    name = names + material.name
    if spec.material(name) is None:
        spec.add_material(
            name=name,
            rgba=material.rgba,
            emission=material.emission,
            specular=material.specular,
            shininess=material.shininess,
        )
    return name


def _file_of(source: mujoco.MjSpec, mesh: mujoco.MjsMesh) -> Path:
    return Path(source.modelfiledir) / source.meshdir / mesh.file
