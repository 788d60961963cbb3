"""Write the reference pages of tasks, robots and options from the code.

python tools/reference_pages.py    # writes docs/tasks, docs/robots and docs/options.md; a test finds stale ones
"""

from __future__ import annotations

import ast
import dataclasses
import inspect
import re
import textwrap
from collections.abc import Iterable, Sequence
from importlib import import_module
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any, get_args, get_type_hints

import numpy as np
from gymnasium import spaces
from rcs_data.record import Record, accepted, valid_values

import rcs
from rcs.devices import lookup
from rcs.envs import Task
from rcs.envs.reward import RewardKind
from rcs.envs.setup import AtEnd, RelativeTo
from rcs.envs.spaces import UNITS, Control
from rcs.robots import ArmDescription, CameraDescription, GripperDescription, HandDescription
from rcs.setups import CameraMount, Lab, ids, lab_of, tasks_of
from rcs.sim.camera import Quality
from rcs.sim.detail import Assets
from rcs.sim.randomisation import Preset
from rcs.sim.world import Stepping
from rcs.tasks.lift_bar import MAX_YAW

DOCS = Path(__file__).parents[1] / "docs"
CONTROLS = ("joints", "tquat", "xyzrpy", "twist")
TASKS = ("PickCuboid", "Place", "StackCuboid", "Push", "PickToy", "LiftBar", "Free")
NOTE = "<!-- Written by tools/reference_pages.py from the code; do not edit. -->\n"

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

NO_REWARD = "The task has no goal: the reward is 0, no step terminates the episode, and `info` has no `success`."

STARTS = {
    "LiftBar": f"The bar is turned by at most {MAX_YAW:g} rad, so that the arms need not cross.",
}
"""Additional facts about the start of a task."""


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


# --- Pages ------------------------------------------------------------------------------------------------------------


def robots_of(task: str) -> list[str]:
    """Return the robots that have an id with a task."""
    return [robot for name, robot in ids().values() if name == task]


def task_page(name: str) -> str:
    """Return the page of a task."""
    kind: type[Task] = lookup.find("task", name)
    robots = robots_of(name)
    first = robots[0]
    done, *more = paragraphs(kind)
    reward = [text for text in more if text.startswith(("Progress", "The reward"))] or [NO_REWARD]
    parts = [NOTE, f"# {name}\n", figure(f"{slug(name)}_{first}", f"The expert of {name} on {first}"), done + "\n"]
    parts += [text + "\n" for text in more if text not in reward]
    facts = [("instruction", f"“{kind.instruction}”")] if kind.instruction else []
    facts += [("expert", f"`{kind.expert}`")] if kind.expert else []
    parts.append(listed(facts))
    parts.append(
        f'```python\nimport rcs\n\nenv = rcs.make("{name}", robot="{first}")\nenv.reset(seed=0)\nenv.close()\n```\n'
    )
    parts += ["## Success and reward\n", " ".join(reward) + "\n"]
    if name != "Free":
        parts += [
            "`reward=` selects the [reward](../guide.md#rewards). An episode is terminated by success, and "
            "truncated after `max_episode_steps` (300). Set options by `task_options={…}`:\n",
            options_table(kind.Options),
        ]
    parts += ["## Start\n", paragraphs(kind.reset)[0] + " " + STARTS.get(name, "") + "\n"]
    rows = []
    for robot in robots:
        area = lab_of(robot).area
        x, y = (f"{number(c - s / 2)} … {number(c + s / 2)}" for c, s in zip(area.center, area.size, strict=True))
        key = next(key for key, value in ids().items() if value == (name, robot))
        cameras = ", ".join(f"`{camera}`" for camera in lab_of(robot).cameras)
        rows.append((f"[{robot}](../robots/{robot}.md)", f"`{key}`", x, y, number(area.object_scale), cameras))
    head = ("robot", "id of `gymnasium.make`", "x [m]", "y [m]", "scale of objects", "cameras")
    parts += [
        "Position and yaw are uniform over this area of the scene:\n" if name != "Free" else "",
        table(head, rows),
    ]
    env = rcs.make(name, robot=first, cameras=tuple(lab_of(first).cameras)[:1])
    parts += [f"## Observation\n\nFor `{first}` with one of its cameras:\n", space_table(env.observation_space)]
    env.close()
    parts += ["## Action\n", action_table(name, first), "## Info\n", info_table(name, first)]
    return "\n".join(part for part in parts if part)


def robot_page(robot: str) -> str:
    """Return the page of a robot."""
    lab = lab_of(robot)
    arm: ArmDescription = lookup.find("arm", lab.stands[0].arm)
    effector: GripperDescription | HandDescription | None = None
    for kind in ("gripper", "hand"):
        if lab.end_effector in lookup.names(kind):
            effector = lookup.find(kind, lab.end_effector)
    task = tasks_of(robot)[0]
    title = arm.label if len(lab.stands) == 1 else f"{len(lab.stands)} × {arm.label}"
    parts = [NOTE, f"# {title}\n", figure(f"{slug(task)}_{robot}", f"{task} on {robot}")]
    module = import_module(entry_points(group="rcs.labs")[robot].module)
    facts = [
        ("name", f"`{robot}`"),
        ("lab", paragraphs(module)[0]),
        ("tasks", ", ".join(f"[{name}](../tasks/{slug(name)}.md)" for name in [*tasks_of(robot), "Free"])),
        ("reach of the flange", f"{number(arm.workspace_reach)} m"),
    ]
    if isinstance(effector, GripperDescription):
        figures = f"opens to {number(1000 * effector.max_width)} mm, grasps with {number(effector.grasp_force)} N"
        facts.append(("end effector", f"`{effector.name}`, {effector.label}: {figures}"))
    elif effector is not None:
        facts.append(("end effector", f"`{effector.name}`, {effector.label}: {len(effector.joints)} joints"))
    parts += [listed(facts), "## Joints\n"]
    rows = zip(arm.joints, arm.joint_lower, arm.joint_upper, arm.home, arm.velocity_limit, arm.acceleration_limit,
               arm.effort_limit, strict=True)  # fmt: skip
    head = ("joint", "lowest [rad]", "highest [rad]", "home [rad]", "speed [rad/s]", "acceleration [rad/s²]",
            "torque [Nm]")  # fmt: skip
    parts.append(table(head, [(f"`{name}`", *map(number, figures)) for name, *figures in rows]))
    parts += ["## Cameras\n", camera_table(lab)]
    has_depth = all(lookup.find("camera", mount.camera).has_depth for mount in lab.cameras.values())
    env = rcs.make("Free", robot=robot, cameras=rcs.Cameras(names=tuple(lab.cameras), depth=has_depth))
    named = "all cameras and `depth=True`" if has_depth else "all cameras"
    parts += [f"## Observation\n\nWith {named}:\n", space_table(env.observation_space)]
    env.close()
    parts += ["## Action\n", action_table("Free", robot), "## Sources of the figures\n"]
    parts.append("\n".join(f"- {source}" for source in [*arm.sources, *(effector.sources if effector else ())]) + "\n")
    return "\n".join(part for part in parts if part)


def options_page() -> str:
    """Return the reference of all options of `rcs.make`."""
    told = inspect.getdoc(rcs.make) or ""
    args = re.search(r"Args:\n(.*?)\n\n", told, re.DOTALL)
    assert args is not None
    rows = [
        (f"`{name}`", " ".join(text.split()))
        for name, text in re.findall(r"^    (\w+): (.*?)(?=\n    \w|\Z)", args[1], re.DOTALL | re.MULTILINE)
        if name != "options"
    ]
    parts = [
        NOTE,
        "# Options\n",
        "All options of `rcs.make`. `rcs.make_vec` accepts the fields of `Setup`, `layers`, and also `copies`, "
        "`threads` and `autoreset`.\n",
        '```python\nimport rcs\n\nenv = rcs.make("PickCuboid", robot="ur5e", control="tquat", relative="absolute")\n'
        "env.close()\n```\n",
        "## Fields of `Setup`\n",
        "These fields define the environment. A dataset stores them, and `rcs.Setup(...)` is a record of them, which "
        '`rcs.make` accepts instead of a task. `relative=True` is short for `"last_step"`, `relative=False` for '
        '`"absolute"`.\n',
        options_table(rcs.Setup),
        "## Fields of `Cameras`\n",
        "`cameras=` accepts names, `all`, your own mounts by name, or `rcs.Cameras(...)` with these fields. On the "
        "command line they are further options: `--cameras`, `--image-size`, `--camera-mode`, `--camera-fps`, "
        "`--camera-noise`, `--depth` and so on.\n",
        options_table(rcs.Cameras),
        "## Arguments of `rcs.make`\n",
        "These arguments concern only the present run and are not stored.\n",
        table(("argument", "meaning"), rows),
        "## Ranges of `Randomisation`\n",
        '`randomisation=True` or `"default"` takes these, `"mild"` half and `"strong"` about twice as much; '
        "`rcs.Randomisation(...)` changes some, and `rcs.Randomisation.off(...)` varies only the given ones.\n",
        options_table(rcs.Randomisation),
        "## Options of `FieldRange`\n",
        "A range of any numeric field of the MuJoCo model; `Randomisation(fields=(…,))` takes any number of them.\n",
        options_table(rcs.FieldRange),
    ]
    return "\n".join(parts)


def pages() -> dict[Path, str]:
    """Return every page by its path."""
    made = {"options": options_page(), **{f"tasks/{slug(name)}": task_page(name) for name in TASKS}}
    made |= {f"robots/{robot}": robot_page(robot) for robot in lookup.names("lab")}
    return {DOCS / f"{name}.md": text.rstrip() + "\n" for name, text in made.items()}


if __name__ == "__main__":
    for path, text in pages().items():
        path.write_text(text, "utf-8")
        print(path.relative_to(DOCS.parent))
