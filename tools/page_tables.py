"""Tables and lists of the reference pages: spaces, infos, cameras and options, from the code."""

from __future__ import annotations

import ast
import dataclasses
import inspect
import re
import textwrap
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, get_args, get_type_hints

import numpy as np
from gymnasium import spaces
from rcs_data.options import Record, accepted, valid_values

import rcs
from rcs.devices import lookup
from rcs.envs.reward import RewardKind
from rcs.envs.setup import AtEnd, RelativeTo
from rcs.envs.spaces import UNITS, Control
from rcs.robots import CameraDescription
from rcs.setups import CameraMount, Lab
from rcs.sim.camera import Quality
from rcs.sim.detail import Assets
from rcs.sim.randomisation import Preset
from rcs.sim.world import Stepping

DOCS = Path(__file__).parents[1] / "docs"
CONTROLS = ("joints", "tquat", "xyzrpy", "twist")


MEANINGS = {  # keys of observations, then those of info
    "joints": "joint positions",
    "tquat": "TCP in the base frame: translation, quaternion xyzw",
    "xyzrpy": "TCP in the base frame: translation; roll, pitch, yaw about the fixed x, y, z axes",
    "joint_velocities": "joint velocities",
    "gripper": "opening: 0 closed … 1 open",
    "hand": "finger joints, normalised to their ranges",
    "rgb": "colour, rows from the top",
    "depth": "depth; 0 where there is no reading; only with `depth=True`",
    "segmentation": "instance number; only with `segmentation=True`",
    "geoms": "geom number; only with `segmentation=True`",
    "points": "position of each pixel's surface; only with `points=True`",
    "intrinsics": "camera matrix",
    "distortion": "k1, k2, p1, p2, k3 of the lens, as in OpenCV",
    "extrinsics": "pose of the camera as a matrix; x right, y down, z forward",
    "success": "true if the task is done",
    "is_grasped": "true if both pads of the gripper (with two arms, of both) press on the object",
    "is_touched": "true if any part of the robot presses on the object",
    "cuboid": "pose of the cuboid in the robot's base frame: translation [m], quaternion xyzw",
    "goal": "goal pose of the object, at any yaw, in the robot's base frame: as above",
    "edges": "edges of the object along its x, y, z [m]",
    "was_lifted": "true if the block was lifted or grasped, which fails the episode",
    "block": "pose of the block in the robot's base frame: translation [m], quaternion xyzw",
    "toy": "pose of the toy in the robot's base frame: translation [m], quaternion xyzw; only its yaw counts",
    "bar_in_scene": "pose of the bar in the scene: translation [m], quaternion xyzw",
    "grasp_offset": "distance of each grasp from the middle of the bar, along its y axis [m]",
    "instruction": "text prompt of a language-conditioned policy; after `reset` only",
    "time": "time of the observation [s]",
    "end": "why the step ended: `period`, `converged`, `interrupted`, `limit`, `diverged`, `fault`; after `step` only",
    "target": "absolute targets that result from the action, by key; after `step` only",
    "is_limited": "true if a joint target was clipped to the robot's speed; after `step` only",
    "ik_status": "result of the inverse kinematics, an `IkStatus`; not with `joints`; after `step` only",
}
"""Meaning of the keys of observations, actions and info; a missing key is an error."""


VALUES = {
    "Quality": get_args(Quality), "Assets": get_args(Assets), "Control": get_args(Control), "Preset": get_args(Preset),
    "RelativeTo": get_args(RelativeTo), "RewardKind": get_args(RewardKind), "Stepping": get_args(Stepping),
    "AtEnd": get_args(AtEnd),
}  # fmt: skip
"""Values of options by the name of their type."""


# --- Text -------------------------------------------------------------------------------------------------------------


def table(head: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    """Return a table of Markdown."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(str(cell).replace("|", "\\|") for cell in line) + " |" for line in lines) + "\n"


def listed(facts: Iterable[tuple[str, str]]) -> str:
    """Return a list of facts."""
    return "".join(f"- **{name[:1].upper()}{name[1:]}:** {text}\n" for name, text in facts)


def number(value: float) -> str:
    """Return a number with as many digits as people read."""
    return f"{float(value):.3f}".rstrip("0").rstrip(".").replace("-", "−")


def span(low: Any, high: Any) -> str:
    """Return a range."""
    low, high = float(low), float(high)
    return f"±{number(high)}" if low == -high and high else f"{number(low)} … {number(high)}"


def bounds(box: spaces.Box) -> str:
    """Return the bounds of a space; equal neighbours are counted."""
    spans = [span(low, high) for low, high in zip(box.low.reshape(-1), box.high.reshape(-1), strict=True)]
    runs: list[list[Any]] = []
    for one in spans:
        if runs and runs[-1][0] == one:
            runs[-1][1] += 1
        else:
            runs.append([one, 1])
    if len(runs) == 1:
        return runs[0][0]
    return ", ".join(one if count == 1 else f"{count} × {one}" for one, count in runs)


def paragraphs(thing: Any) -> list[str]:
    """Return the paragraphs of a docstring, each on one line."""
    return [" ".join(part.split()) for part in (inspect.getdoc(thing) or "").split("\n\n")]


def fields_of(kind: Any) -> list[tuple[str, str, Any, str]]:
    """Return name, type, default and docstring of every field of a dataclass."""
    told: dict[str, tuple[str, str]] = {}
    for base in reversed(kind.__mro__[:-1]):
        body = ast.parse(textwrap.dedent(inspect.getsource(base))).body[0].body  # pyright: ignore[reportAttributeAccessIssue]
        for line, after in zip(body, [*body[1:], None], strict=True):
            if isinstance(line, ast.AnnAssign) and isinstance(after, ast.Expr):
                text = " ".join(str(ast.literal_eval(after.value)).split())
                told[ast.unparse(line.target)] = ast.unparse(line.annotation), text
    found = []
    for own in dataclasses.fields(kind):
        default = own.default if own.default_factory is dataclasses.MISSING else own.default_factory()
        found.append((own.name, *told[own.name][:1], default, told[own.name][1]))
    return found


def slug(name: str) -> str:
    """Return the name of a page: `PickCuboid` is `pick_cuboid`."""
    return re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", name).lower()


def figure(name: str, words: str) -> str:
    """Return a moving picture where there is one."""
    return f"![{words}](../img/{name}.webp)\n" if (DOCS / "img" / f"{name}.webp").exists() else ""


# --- Tables -----------------------------------------------------------------------------------------------------------


def leaves(space: spaces.Space[Any], above: str = "") -> Iterable[tuple[str, spaces.Box]]:
    """Return every array of a space, with the path of its keys."""
    if isinstance(space, spaces.Dict):
        for key, inner in space.spaces.items():
            yield from leaves(inner, f"{above}/{key}" if above else key)
    elif isinstance(space, spaces.Box):
        yield above, space


def space_table(space: spaces.Space[Any]) -> str:
    """Return keys, shapes, types, units and bounds."""
    rows = []
    for path, box in leaves(space):
        key = path.rpartition("/")[2]
        named = " → ".join(f"`{part}`" for part in path.split("/"))
        unit = UNITS.get(key, "")
        rows.append((named, f"{box.shape} {box.dtype}", unit, bounds(box), MEANINGS[key]))
    return table(("key", "shape and type", "unit", "bounds", "meaning"), rows)


def action_table(task: str, robot: str) -> str:
    """Return the keys of actions in every control mode, absolute and relative."""
    rows = []
    for control in CONTROLS:
        for relative in ("last_step", "absolute") if control != "twist" else ("last_step",):
            env = rcs.make(task, robot=robot, control=control, relative=relative)
            for path, box in leaves(env.action_space):
                parts = path.split("/")
                if parts[-1] == control and parts[:-1] in ([], [next(iter(env.robots))]):
                    mode = f'`control="{control}"`' + (', `relative="absolute"`' if relative == "absolute" else "")
                    rows.append((mode, f"`{control}`", box.shape, UNITS[control], bounds(box)))
            env.close()
    env = rcs.make(task, robot=robot)
    for path, box in leaves(env.action_space):
        if (key := path.rpartition("/")[2]) in ("gripper", "hand"):
            rows.append(("always", f"`{key}`", box.shape, UNITS.get(key, ""), bounds(box)))
            break
    several = [f"`{name}`" for name in env.robots] if len(env.robots) > 1 else []
    env.close()
    told = f"An action has one dictionary per robot, under {' and '.join(several)}; each has these keys.\n\n"
    return (told if several else "") + table(("mode", "key", "shape", "unit", "bounds"), rows)


def info_table(task: str, robot: str) -> str:
    """Return the keys of info after a reset and a step."""
    env = rcs.make(task, robot=robot, control="tquat")
    _, info = env.reset(seed=0)
    *_, after = env.step(env.action_space.sample())
    env.close()
    rows = []
    for key, value in {**info, **after}.items():
        name = key.rpartition("/")[2]
        if "/" in key and not key.startswith(next(iter(env.robots))):
            continue  # the other robot's are the same
        named = f"`{name}`" if "/" not in key else f"`{key}`, and so on"
        kind = "dictionary" if isinstance(value, dict) else f"{np.shape(value)} {np.asarray(value).dtype}"
        kind = kind if np.shape(value) or isinstance(value, dict) else type(value).__name__
        rows.append((named, kind, MEANINGS[name]))
    return table(("key", "type", "meaning"), rows)


def camera_table(lab: Lab) -> str:
    """Return the cameras of a lab and where they are."""

    def row(name: str, mount: CameraMount) -> tuple[str, ...]:
        camera: CameraDescription = lookup.find("camera", mount.camera)
        where = "fixed in the scene" if mount.on_gripper_of is None else f"on the gripper of `{mount.on_gripper_of}`"
        depth = f"{number(camera.depth_range[0])} … {number(camera.depth_range[1])} m" if camera.has_depth else "none"
        seen = None if mount.calibration is None else mount.calibration.intrinsics
        field_of_view = camera.fovy if seen is None else 2 * np.arctan(0.5 * seen.height / seen.fy)
        return f"`{name}`", camera.label, where, f"{number(np.rad2deg(field_of_view))}°", depth

    head = ("name", "camera", "mounting", "vertical field of view", "depth")
    return table(head, [row(name, mount) for name, mount in lab.cameras.items()])


PLAIN = {
    "Whole": "int", "Natural": "int", "Edge": "int", "Size": "tuple[int, int]", "Positive": "float", "Share": "float",
    "NotNegative": "float",
}  # fmt: skip
"""Types with bounds, as people read them; what is out of bounds is refused in words."""


def choices(annotation: str) -> str:
    """Return an annotation as people read it: a list of values where it has some."""
    shown = []
    for kind in re.split(r" \| (?![^\[]*\])", annotation):
        values = VALUES.get(kind, ())
        if kind.startswith("Literal["):
            values = ast.literal_eval(f"({kind[8:-1]},)")
        shown += [f'`"{value}"`' for value in values] or [f"`{kind}`"]
    return " or ".join(shown)


def options_table(kind: Any) -> str:
    """Return the fields of a dataclass with their defaults."""
    rows = []
    wider = {one.name: accepted(one) for one in dataclasses.fields(kind) if "converter" in one.metadata}
    for name, annotation, default, told in fields_of(kind):
        annotation = re.sub(r"Annotated\[(\w+), .*?\)\]", r"\1", wider.get(name, annotation))
        annotation = re.sub(r"\b(\w+)\b", lambda word: PLAIN.get(word[1], word[1]), annotation)
        shown = f'"{default}"' if isinstance(default, str) else str(default)
        given = "" if default is dataclasses.MISSING else f"`{shown}`"
        is_checked = issubclass(kind, Record) and name not in wider
        valid = valid_values(get_type_hints(kind, include_extras=True)[name]) if is_checked else ""
        rows.append((f"`{name}`", valid or choices(annotation), given, told))
    return table(("option", "type", "default", "meaning"), rows)
