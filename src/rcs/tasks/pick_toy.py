"""Pick-Toy: grasp a soft toy that lies anywhere in the workspace, lift it and bring it back to the home pose."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from rcs.envs.episode_random import EpisodeRandom
from rcs.envs.layers import CopyIndex
from rcs.envs.task import Judgement
from rcs.kinematics import kinematics_of
from rcs.robots.description import GripperDescription, HandDescription
from rcs.sim.robot import SimRobot
from rcs.sim.scene import Scene
from rcs.sim.world import World
from rcs.spatial import compose, inverse
from rcs.tasks.holding import HoldTimer, all_but
from rcs.tasks.lifting import LiftOptions, norm, progress, table_height
from rcs.tasks.table_task import TableTask, require_robots

SIZE = (0.09, 0.075, 0.07)
"""Length, width and height of the toy, an ellipsoid [m]."""
MASS = 0.08
"""Mass of the toy [kg]. Our choice, like its stiffness: the paper only says that it is deformable."""
YOUNG = 2e4
"""Young's modulus [Pa]: a power grasp squeezes the toy by 15 to 30 %, its own weight by less than 1 %."""
POISSON = 0.3
"""Foams have 0.1 to 0.4."""
DAMPING = 2e-3
"""Damping in proportion to stiffness [s]: it stops swinging within a few tenths of a second."""
GRID = 6
"""Vertices along each edge. An even number: the bottom is then a small face to lie on, not a point."""
SKIN = 0.002
"""Radius of the skin around vertices and faces [m]."""
SETTLE_TIME = 1.0
"""Time for the toy to come to rest under its own weight [s]."""
NEAR_HOME = 0.05
"""Distance of the TCP from its start at which the arm is back home [m]."""
TOUCH_FORCE = 0.2
"""Least force of a robot that counts as contact with the toy [N]: half the weight of the lightest toy."""
SHIFT = 0.03
"""Distance that the toy's middle may move in the hand while it counts as held [m]: it is soft, and settles."""
TOY = "toy"


class PickToy(TableTask):
    """Lift a soft toy, by 10 cm by default, and hold it at the arm's home pose for one second.

    It is a success when, without a break for that time, the TCP is within 5 cm of where it is at home, the toy's middle
    is 10 cm higher than when it lies, the thumb and the other fingers (of a gripper: both pads) press on it with more
    than its weight each, nothing but the hand touches it, and its middle moves by no more than 3 cm in the hand. This
    is judged at the end of each step.

    The toy is a flex whose shape follows eight nodes, the corners of a box around it. Each has three slide joints along
    the scene's axes, so that its position, orientation and shape are all in `qpos`. Rotating it means moving the nodes,
    which MuJoCo's elasticity permits without stress.

    Progress, of which the reward is made, is the mean of three parts in [0, 1]: reaching, grasping, and lifting and
    carrying home while grasping.
    """

    memory = ("_nodes", "_rest_height", "_weight", "_held")
    names = (TOY,)
    instruction = "pick up the toy"
    expert = "ToyExpert"
    Options = LiftOptions
    options: LiftOptions

    def furnish(self, scene: Scene) -> None:
        """Add a table and the toy."""
        scene.add_table()
        _add_toy(scene.spec, (*self.area.center, self.area.object_scale * SIZE[2] / 2), self.area.object_scale)

    def bind(self, world: World, robots: list[SimRobot]) -> None:
        """Look up the toy's nodes and register the robot's force on it for readout.

        Raises:
            InvalidSetup: There is not exactly one robot, or it has neither gripper nor hand.
        """
        require_robots("PickToy", robots, hands=True)
        self._world = world
        self._robot = robots[0]
        placement, effector = self._robot.placement, self._robot.placement.end_effector
        assert effector is not None, "it is required"
        model = world.model
        self._touched = world.core.read_force(world.subtree_flags(placement.base_body), world.subtree_flags(TOY))
        self._fingers = [
            world.core.read_force(
                world.geom_flags(placement.gripper_prefix + name for name in geoms), world.subtree_flags(TOY)
            )
            for geoms in _opposed(effector)
        ]
        hand = placement.gripper_prefix + effector.base_body
        self._others = world.core.read_force(all_but(world, hand, TOY), world.subtree_flags(TOY))
        self._gravity = float(np.linalg.norm(model.opt.gravity))
        self._weight = np.zeros(world.leading)
        self._center, nodes, self._qpos = _nodes_of(model)
        self._bodies = _node_bodies(model)
        self._nominal = float(nodes[0, 0]), float(model.body_mass[self._bodies[0]])
        """A length [m] and a mass [kg] of the toy that was made; the others are in proportion to it."""
        self._lying = _lying(self.area.object_scale)
        self._along = np.sign(nodes[:, :1])  # +1 for nodes at the toy's front, -1 at its back
        self._nodes = np.empty((*world.leading, *nodes.shape))
        """Nodes of the toy when nothing pulls at them, relative to the carrier, which does not move."""
        self._rest_height = np.empty(world.leading)
        self._measure(...)
        self._scene_in_base = inverse(placement.base_in_scene.pose.tquat)
        home = kinematics_of(placement.arm, placement.end_effector).forward(np.array(placement.arm.home))
        self._home = home.tquat[:3]
        self._held = HoldTimer(world, self.options.hold_time, SHIFT, places=1)

    def _measure(self, where: CopyIndex) -> NDArray[np.float64]:
        """Take over how large and heavy the toys are, which may vary between episodes.

        Returns:
            Nodes of the toys as they lie [m], (*leading, nodes, 3): x and y from their middle, z in the scene.
        """
        nodes = self._world.field("body_pos")[where][..., self._bodies, :]
        mass = self._world.field("body_mass")[where][..., self._bodies[0]]
        lying = self._lying.nodes(nodes[..., 0, 0] / self._nominal[0], mass / self._nominal[1])
        lying[..., 2] += table_height(self._world)[where][..., None]
        self._nodes[where] = nodes
        self._rest_height[where] = _mean(lying)[..., 2]
        self._weight[where] = len(self._bodies) * mass * self._gravity
        return lying

    def reset(self, random: EpisodeRandom, where: CopyIndex) -> None:
        """Lay the toy down at a random place and yaw, as it lies under its own weight."""
        lying = self._measure(where)
        place = self.area.draw_place(random)
        self._lay(lying, place[..., :2], place[..., 2:], where)
        self._held.reset(where)

    def object_poses(self) -> dict[str, NDArray[np.float64]]:
        """Return where the toy is: its centre and yaw, in the scene."""
        return {TOY: self._pose(self._present_nodes())}

    def place(self, poses: Mapping[str, NDArray[np.float64]], where: CopyIndex) -> None:
        """Lay the toy down somewhere in the shape in which it lies; of its turn only the yaw counts."""
        if TOY not in poses:
            return
        pose = poses[TOY]
        lying = self._measure(where).copy()
        lying[..., 2] += (pose[..., 2] - self._rest_height[where])[..., None]
        x, y, z, w = (pose[..., i : i + 1] for i in range(3, 7))
        self._lay(lying, pose[..., :2], np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)), where)

    def _lay(
        self, lying: NDArray[np.float64], center: NDArray[np.float64], yaw: NDArray[np.float64], where: CopyIndex
    ) -> None:
        """Write lying nodes (..., nodes, 3) with their middle over a place (..., 2), turned by a yaw (..., 1)."""
        cos, sin = np.cos(yaw), np.sin(yaw)
        x, y = lying[..., 0], lying[..., 1]
        nodes = np.empty_like(lying)
        nodes[..., 0] = center[..., 0:1] + cos * x - sin * y
        nodes[..., 1] = center[..., 1:2] + sin * x + cos * y
        nodes[..., 2] = lying[..., 2]
        self._world.qpos[where, self._qpos] = (nodes - self._center - self._nodes[where]).reshape(*yaw.shape[:-1], -1)

    def evaluate(self) -> Judgement:
        """Judge height, grasp and how long the toy was held at home."""
        in_scene = self._pose(self._present_nodes())
        toy, tcp = compose(self._scene_in_base, in_scene), self._world.poses[..., self._robot.tcp_readout, :]
        forces = self._world.forces
        height = in_scene[..., 2] - self._rest_height
        presses = forces[..., self._fingers] > self._weight[..., None]
        is_grasped = presses[..., 0] & presses[..., 1]
        from_home = norm(tcp[..., :3] - self._home)
        goal = self.options.lift_height
        is_held = is_grasped & (height > goal) & (from_home < NEAR_HOME) & (forces[..., self._others] == 0.0)
        success = self._held.count(is_held, compose(inverse(tcp), toy)[..., None, :3])
        back = 1.0 - np.tanh(5.0 * np.maximum(from_home - NEAR_HOME, 0.0))
        come = progress(norm(toy[..., :3] - tcp[..., :3]), is_grasped, (0.5 + 0.5 * back) * height / goal)
        is_touched = forces[..., self._touched] > TOUCH_FORCE
        info = {"is_grasped": is_grasped, "is_touched": is_touched, TOY: toy}
        return Judgement(success=success, progress=come, is_placed=is_held, info=info)

    def seen(self) -> dict[str, NDArray[Any]]:
        """Return where the toy is in the robot's base frame."""
        return {TOY: compose(self._scene_in_base, self._pose(self._present_nodes()))}

    def _present_nodes(self) -> NDArray[np.float64]:
        """Return the nodes in the scene [m], (*leading, nodes, 3)."""
        moved = self._world.qpos[..., self._qpos]
        return self._center + self._nodes + moved.reshape(self._nodes.shape)

    def _pose(self, nodes: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the centre of nodes, and the yaw of the line from their back to their front, (*leading, 7)."""
        front = _sum(nodes * self._along)
        half_yaw = 0.5 * np.arctan2(front[..., 1], front[..., 0])
        pose = np.zeros((*self._world.leading, 7))
        pose[..., :3] = _mean(nodes)
        pose[..., 5], pose[..., 6] = np.sin(half_yaw), np.cos(half_yaw)
        return pose


# NumPy's own sums add in an order that may depend on how many copies there are.
def _sum(nodes: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.add.accumulate(nodes, axis=-2)[..., -1, :]


def _mean(nodes: NDArray[np.float64]) -> NDArray[np.float64]:
    return _sum(nodes) / nodes.shape[-2]


def _opposed(effector: GripperDescription | HandDescription) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the geoms of the pads of a gripper, or of the thumb and of all other fingers of a hand."""
    if isinstance(effector, GripperDescription):
        return effector.pad_geoms
    thumb, *others = effector.finger_geoms.values()
    return thumb, tuple(name for finger in others for name in finger)


def _add_toy(spec: mujoco.MjSpec, center: tuple[float, float, float], scale: float) -> None:
    # The only one of MuJoCo's implicit integrators that has room for the stiffness of flexes; with it the toy is stable
    # at the time step of the other tasks.
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_DISCRETE
    carrier = spec.worldbody.add_body(name=TOY, pos=center)
    flex = carrier.make_flex(
        name=TOY,
        type="ellipsoid",
        dim=3,
        dof="trilinear",
        count=[GRID] * 3,
        spacing=[(scale * edge - 2 * SKIN) / (GRID - 1) for edge in SIZE],
        radius=SKIN,
        mass=MASS * scale**3,
    )
    flex.young = YOUNG
    flex.poisson = POISSON
    flex.damping = DAMPING
    flex.friction = [1.0, 0.01, 0.0001]  # sliding friction of cloth on rubber is about 1
    flex.condim = 4
    flex.solref = [0.01, 1.0]
    flex.selfcollide = mujoco.mjtFlexSelf.mjFLEXSELF_NONE
    flex.rgba = [0.86, 0.47, 0.16, 1.0]
    flex.group = 0


def _node_bodies(model: mujoco.MjModel) -> NDArray[np.intp]:
    """Return the ids of the bodies of the nodes."""
    return np.flatnonzero(model.body_parentid == model.body(TOY).id)


def _nodes_of(model: mujoco.MjModel) -> tuple[NDArray[np.float64], NDArray[np.float64], slice]:
    """Return the carrier's place (3,), the nodes' relative to it (nodes, 3) and where they are in `qpos` [m]."""
    bodies = _node_bodies(model)
    first = int(model.jnt_qposadr[model.body_jntadr[bodies[0]]])  # the nodes follow each other, three joints each
    return model.body(TOY).pos.copy(), model.body_pos[bodies].copy(), slice(first, first + 3 * len(bodies))


@dataclass(frozen=True)
class _Lying:
    """How a toy lies on a table, for any size and mass: three shares of where its nodes are, (nodes, 3) each.

    A toy gives in by its weight over its stiffness, which grows with its size; how far the contact lets it sink in
    depends on neither.
    """

    shape: NDArray[np.float64]
    """Shape of a weightless toy that touches the table [m]."""
    sunk: NDArray[np.float64]
    """Depth that the contact lets it sink in [m]."""
    given_in: NDArray[np.float64]
    """Depth that it gives in under its own weight [m]."""

    def nodes(self, size: NDArray[np.float64], mass: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the nodes from the point on the table under their middle [m], (*leading, nodes, 3).

        Args:
            size: Factor on the size, (*leading,).
            mass: Factor on the mass, (*leading,).
        """
        return size[..., None, None] * self.shape + self.sunk + (mass / size)[..., None, None] * self.given_in


@functools.cache
def _lying(scale: float) -> _Lying:
    """Let a toy, and one of twice its mass, come to rest on a table."""
    scene = Scene.empty()
    scene.add_table()  # a plane would have other contacts
    _add_toy(scene.spec, (0.0, 0.0, scale * SIZE[2] / 2), scale)
    model = scene.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    center, shape, qpos = _nodes_of(model)
    shape += center - [0.0, 0.0, data.flexvert_xpos[:, 2].min() - model.flex_radius[0]]
    rest: list[NDArray[np.float64]] = []
    for factor in (1.0, 2.0):
        model.body_mass[_node_bodies(model)] *= factor
        mujoco.mj_resetData(model, data)
        mujoco.mj_setConst(model, data)
        mujoco.mj_step(model, data, nstep=round(SETTLE_TIME / model.opt.timestep))
        nodes = center + _nodes_of(model)[1] + data.qpos[qpos].reshape(-1, 3)
        nodes[:, :2] -= nodes[:, :2].mean(axis=0)  # it may have rolled a little
        rest.append(nodes)
    given_in = rest[1] - rest[0]
    return _Lying(shape, rest[0] - given_in - shape, given_in)
