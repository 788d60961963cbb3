"""Write the reference pages of tasks, robots and options from the code.

python tools/reference_pages.py    # writes docs/tasks, docs/robots and docs/options.md; a test finds stale ones
"""

from __future__ import annotations

import inspect
import re
from pathlib import Path

from page_tables import (
    DOCS,
    action_table,
    camera_table,
    figure,
    info_table,
    listed,
    number,
    options_table,
    paragraphs,
    slug,
    space_table,
    table,
)

import rcs
from rcs.devices import lookup
from rcs.envs import Task
from rcs.robots import ArmDescription, GripperDescription, HandDescription
from rcs.setups import ids, lab_of, tasks_of
from rcs.tasks.lift_bar import MAX_YAW

TASKS = ("PickCuboid", "Place", "StackCuboid", "Push", "PickToy", "LiftBar", "Free")
NOTE = "<!-- Written by tools/reference_pages.py from the code; do not edit. -->\n"
NO_REWARD = "The task has no goal: the reward is 0, no step terminates the episode, and `info` has no `success`."
STARTS = {
    "LiftBar": f"The bar is turned by at most {MAX_YAW:g} rad, so that the arms need not cross.",
}
"""Additional facts about the start of a task."""


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
    facts = [
        ("name", f"`{robot}`"),
        ("lab", lab.about),
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
