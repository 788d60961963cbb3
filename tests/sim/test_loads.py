"""Forces on a simulated robot, against statics: what its drives exert, what presses on its tool, who touches what."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
import pytest

import rcs
from rcs._core import ArmBody, ArmLoads, CollisionReaction, FingerContacts, FreeBodyVelocity
from rcs.errors import InvalidSetup

ARMS = [("fr3", None), ("ur5e", None), ("xarm7", "robotiq_2f85"), ("so101", None)]
GRAVITY = 9.81


def make(task: str = "Free", robot: str = "fr3", end_effector: str | None = None, **options: Any) -> Any:
    observe = ("torques", "wrench") if task == "Free" else ("torques", "wrench", "contacts")
    form: dict[str, Any] = {"relative": False, "max_episode_steps": None, "collision_reaction": False}
    if task != "Free":
        form["task_options"] = {"hold_time": 100.0}
    return rcs.make(task, robot=robot, end_effector=end_effector, observe=observe, **{**form, **options})


def stay(env: Any, observation: Any, *, steps: int = 60, **change: Any) -> Any:
    """Have the arm stay for a while, and return the last observation."""
    action = {"joints": observation["joints"], "gripper": np.ones(1, np.float32), **change}
    for _ in range(steps):
        observation, *_ = env.step(action)
    return observation


@pytest.mark.parametrize(("robot", "end_effector"), ARMS)
def test_torques_hold_the_weight_and_what_pushes(robot: str, end_effector: str | None) -> None:
    env = make(robot=robot, end_effector=end_effector)
    observation, _ = env.reset(seed=0)
    world = env.simulation.world
    model, data, layout = world.model, world.data, env.simulation.robots[0].layout
    hand, dofs = model.site_bodyid[layout.tcp_site], model.jnt_dofadr[layout.joint_ids]
    base = data.xmat[layout.base_body].reshape(3, 3)
    for push in (np.zeros(6), np.array([3.0, -2.0, 5.0, 0.2, 0.1, -0.1])):
        data.xfrc_applied[hand] = push
        seen = stay(env, observation)
        jacobian = np.zeros((6, model.nv))
        mujoco.mj_jac(model, data, jacobian[:3], jacobian[3:], data.xipos[hand], hand)
        # At rest, friction may carry a share of it.
        friction = data.qfrc_constraint[dofs]
        expected = data.qfrc_bias[dofs] - jacobian[:, dofs].T @ push - friction
        np.testing.assert_allclose(seen["joint_torques"], expected, atol=1e-3)
        lever = data.xipos[hand] - data.site_xpos[layout.tcp_site]
        wrench = np.concatenate([base.T @ push[:3], base.T @ (push[3:] + np.cross(lever, push[:3]))])
        np.testing.assert_allclose(seen["tcp_wrench"], wrench, atol=1e-6)


def test_the_first_observation_has_forces_and_measuring_changes_nothing() -> None:
    with_loads, without = make(), rcs.make("Free", relative=False, max_episode_steps=None)
    observation, _ = with_loads.reset(seed=0)
    plain, _ = without.reset(seed=0)
    assert np.abs(observation["joint_torques"]).max() > 5.0
    action = {"joints": observation["joints"] + 0.1, "gripper": np.zeros(1, np.float32)}
    for _ in range(5):
        observation, *_ = with_loads.step(action)
        plain, *_ = without.step(action)
        np.testing.assert_array_equal(observation["joints"], plain["joints"])


def grasped(env: Any, seed: int = 0) -> Any:
    """Have the gripper hold the cuboid in the air, and return the observation."""
    observation, _ = env.reset(seed=seed)
    tcp = observation["tquat"]
    pose = np.array([*tcp[:3], 0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5)])
    observation, _ = env.reset(seed=seed, options={"objects": {"cuboid": pose}})
    # It floats until the gripper has closed.
    gravcomp, body = env.simulation.world.model.body_gravcomp, env.simulation.world.model.body("cuboid").id
    gravcomp[body] = 1.0
    observation = stay(env, observation, steps=30, gripper=np.zeros(1, np.float32))
    gravcomp[body] = 0.0
    return stay(env, observation, steps=10, gripper=np.zeros(1, np.float32))


def test_a_mass_that_hangs_in_the_gripper_weighs_what_it_weighs() -> None:
    env = make("PickCuboid")
    world = env.simulation.world
    mass = world.model.body("cuboid").mass[0]
    observation = grasped(env)
    assert observation["is_grasped"] == [1]
    observation = stay(env, observation, steps=60, gripper=np.zeros(1, np.float32))
    force, moment = observation["tcp_wrench"][:3], observation["tcp_wrench"][3:]
    # The pads press with 30 N each; these forces cancel out.
    np.testing.assert_allclose(force, [0.0, 0.0, -mass * GRAVITY], atol=0.02)
    offset = world.data.body("cuboid").xipos - world.data.site_xpos[env.simulation.robots[0].layout.tcp_site]
    np.testing.assert_allclose(moment, np.cross(offset, [0.0, 0.0, -mass * GRAVITY]), atol=2e-3)


def test_the_arm_carries_what_it_holds() -> None:
    env = make("PickCuboid")
    world, layout = env.simulation.world, env.simulation.robots[0].layout
    observation = stay(env, grasped(env), steps=60, gripper=np.zeros(1, np.float32))
    jacobian = np.zeros((6, world.model.nv))
    mujoco.mj_jacSite(world.model, world.data, jacobian[:3], jacobian[3:], layout.tcp_site)
    dofs = world.model.jnt_dofadr[layout.joint_ids]
    held = world.data.qfrc_bias[dofs] - jacobian[:, dofs].T @ observation["tcp_wrench"]
    # At rest, the joints' own friction may carry a share of it.
    rows = world.data.efc_type == int(mujoco.mjtConstraint.mjCNSTR_FRICTION_DOF)
    friction = np.zeros(world.model.nv)
    friction[world.data.efc_id[rows]] = world.data.efc_force[rows]
    np.testing.assert_allclose(observation["joint_torques"], held - friction[dofs], atol=0.01)


def test_a_grasp_is_two_fingers_on_the_same_object() -> None:
    env = make("PickCuboid")
    observation, _ = env.reset(seed=0)
    np.testing.assert_array_equal([*observation["finger_contacts"], *observation["is_grasped"]], [0, 0, 0])
    # Nothing between the fingers.
    observation = stay(env, observation, steps=20, gripper=np.zeros(1, np.float32))
    np.testing.assert_array_equal([*observation["finger_contacts"], *observation["is_grasped"]], [0, 0, 0])
    observation = grasped(env)
    np.testing.assert_array_equal([*observation["finger_contacts"], *observation["is_grasped"]], [1, 1, 1])
    observation = stay(env, observation, steps=20)
    np.testing.assert_array_equal([*observation["finger_contacts"], *observation["is_grasped"]], [0, 0, 0])


SCENE = """
<mujoco>
  <option timestep="0.002" gravity="0 0 0"/>
  <worldbody>
    <body name="wall" pos="0 0 -0.0199"><geom name="wall" type="box" size="1 1 0.01"/></body>
    <body name="arm">
      <joint name="arm" type="slide" axis="0 0 1"/>
      <geom type="sphere" size="0.01" mass="1" contype="0" conaffinity="0"/>
      <site name="tcp"/>
      <geom name="left" type="sphere" size="0.01" pos="-0.1 0 0"/>
      <geom name="right" type="sphere" size="0.01" pos="0.1 0 0"/>
    </body>
    <body name="one" pos="-0.1 {one} 0"><freejoint/><geom type="box" size="{width} 0.01 0.01" mass="1"/></body>
    <body name="two" pos="0.1 {two} 0"><freejoint/><geom type="box" size="0.02 0.01 0.01" mass="1"/></body>
  </worldbody>
  <actuator><motor joint="arm"/></actuator>
</mujoco>
"""


@pytest.mark.parametrize(
    ("one", "width", "two", "wall", "flags"),
    [
        (0.5, 0.02, 0.5, False, [0, 0, 0]),
        (0.0199, 0.02, 0.5, False, [1, 0, 0]),
        (0.0199, 0.02, 0.0199, False, [1, 1, 0]),  # two objects, one each
        (0.0199, 0.5, 0.5, False, [1, 1, 1]),  # one object for both
        (0.5, 0.02, 0.5, True, [1, 1, 0]),  # a wall is touched, and nothing that could be grasped
    ],
)
def test_flags_of_fingers_are_those_of_who_touches_what(
    one: float, width: float, two: float, wall: bool, flags: list[int]
) -> None:
    text = SCENE.format(one=one, two=two, width=width)
    model = mujoco.MjModel.from_xml_string(text if wall else text.replace("-0.0199", "-0.5"))
    world = rcs.sim.World(model)
    left, right = world.geom_flags(["left"]), world.geom_flags(["right"])
    first = world.core.measure(FingerContacts(model, [left, right], world.subtree_flags("arm"), 1e-3))
    world.refresh()
    np.testing.assert_array_equal(world.core.measurements[first : first + 3], flags)


def test_copies_measure_what_one_world_measures() -> None:
    single = make("PickCuboid")
    batch = rcs.make_vec(single.setup, copies=3, threads=2)
    seen, _ = single.reset(seed=1)
    observation, _ = batch.reset(seed=0)
    random = np.random.default_rng(0)
    for step in range(20):
        for key in ("joint_torques", "tcp_wrench", "finger_contacts", "is_grasped"):
            assert observation[key][1].tobytes() == seen[key].tobytes(), key
        joints = observation["joints"] + random.uniform(-0.05, 0.05, (3, 7))
        gripper = np.full((3, 1), float(step < 10), np.float32)
        observation, *_ = batch.step({"joints": joints, "gripper": gripper})
        seen, *_ = single.step({"joints": joints[1], "gripper": gripper[1]})


def test_what_does_not_fit_the_model_is_refused() -> None:
    env, other = make(), make("PickCuboid", robot="ur5e")
    layout, model = env.simulation.robots[0].layout, env.simulation.world.model
    arm = ArmBody(model, layout.joint_ids, layout.tcp_site, layout.base_body)
    with pytest.raises(InvalidSetup, match="another model"):
        other.simulation.world.core.measure(ArmLoads(arm))
    for joints in ([], [-1], [10**6]):
        with pytest.raises(InvalidSetup, match="joint"):
            ArmBody(model, joints, layout.tcp_site, layout.base_body)
    with pytest.raises(InvalidSetup, match="follow each other"):
        ArmBody(model, layout.joint_ids[:3], layout.tcp_site, layout.base_body + 3)
    with pytest.raises(InvalidSetup, match="flags"):
        FingerContacts(model, [np.zeros(2, np.uint8)], np.zeros(model.ngeom, np.uint8), 0.5)
    limits = [10.0] * 7, (1.0,) * 6, False, 0.0, 0.0
    with pytest.raises(InvalidSetup, match="another model"):
        other.simulation.world.core.fault_when(CollisionReaction(arm, *limits, 1))
    with pytest.raises(InvalidSetup, match="for 7 joints"):
        CollisionReaction(arm, [10.0], *limits[1:], 1)
    with pytest.raises(InvalidSetup, match="above 0"):
        CollisionReaction(arm, [0.0] * 7, *limits[1:], 1)
    with pytest.raises(InvalidSetup, match="copies"):
        CollisionReaction(arm, *limits, 0)
    for copy in (-1, 1, 2**31 - 1):
        with pytest.raises(InvalidSetup, match=f"no copy {copy}, valid is 0 to 0"):
            CollisionReaction(arm, *limits, 1).cause(copy)


def test_only_bodies_that_are_free_have_their_velocity_measured() -> None:
    env, other = make("PickCuboid"), make("PickToy")
    model = env.simulation.world.model
    hinge, free = env.simulation.robots[0].layout.joint_ids[0], model.joint("cuboid").id
    for joint in (hinge, -1, 10**6):
        with pytest.raises(InvalidSetup, match="no free joint"):
            FreeBodyVelocity(model, joint, 0)
    with pytest.raises(InvalidSetup, match="frame"):
        FreeBodyVelocity(model, free, 10**6)
    with pytest.raises(InvalidSetup, match="another model"):
        other.simulation.world.core.measure(FreeBodyVelocity(model, free, 0))
