"""A world's scene on pages: what is sent is where the state has things, and what does not move is not sent again."""

from __future__ import annotations

from collections.abc import Iterator

import mujoco
import numpy as np
import pytest
import viser

import rcs
from rcs.errors import InvalidSetup
from rcs.rollout.interactive.page import start_server
from rcs.sim.browser_scene import DISTANCE, BrowserScene


@pytest.fixture
def server() -> Iterator[viser.ViserServer]:
    server = start_server()
    yield server
    server.stop()


def positions(server: viser.ViserServer) -> dict[str, np.ndarray]:
    """Return the position of every body on the page, by its name."""
    nodes = server.scene._handle_from_node_name
    return {
        name.rpartition("/")[2].replace(" · ", "/"): np.concatenate([node.position, node.wxyz])
        for name, node in nodes.items()
        if isinstance(node, viser.FrameHandle) and name.startswith("/scene/") and name.count("/") == 2
    }


@pytest.mark.parametrize(("task", "robot"), [("LiftBar", "dual_fr3"), ("PickToy", "xarm7")])
def test_bodies_are_where_the_state_has_them(server: viser.ViserServer, task: str, robot: str) -> None:
    env = rcs.make(task, robot=robot)
    env.reset(seed=0)
    world = env.simulation.world
    scene = BrowserScene(server, world, list(env.robots.values()))
    for _ in range(3):
        env.step(env.action_space.sample())
    scene.show()
    seen = mujoco.MjData(world.model)
    seen.qpos[:] = world.qpos
    mujoco.mj_kinematics(world.model, seen)
    shown = positions(server)
    assert {"left/link3", "right/link3"} <= set(shown) or "xarm7/link3" in shown
    for name, pose in shown.items():
        body = world.model.body(name).id
        np.testing.assert_allclose(pose, np.concatenate([seen.xpos[body], seen.xquat[body]]), atol=1e-5, err_msg=name)
    meshes = [node for node in server.scene._handle_from_node_name.values() if isinstance(node, viser.MeshHandle)]
    visible = world.model.geom_group < 3
    walls = 3
    assert len(meshes) == visible.sum() - walls + world.model.nflex
    for node in meshes:
        assert np.isfinite(node.vertices).all()
        assert np.ptp(node.vertices, axis=0).max() > 1e-4, node.name
    env.close()


def test_looking_changes_nothing_in_the_simulation(server: viser.ViserServer) -> None:
    states: list[np.ndarray] = []
    for is_seen in (False, True):
        env = rcs.make("PickToy", robot="xarm7")
        env.reset(seed=1)
        env.action_space.seed(0)
        scene = BrowserScene(server, env.simulation.world, list(env.robots.values())) if is_seen else None
        for _ in range(20):
            env.step(env.action_space.sample())
            if scene is not None:
                scene.show()
        states.append(env.simulation.world.states())
        env.close()
    np.testing.assert_array_equal(*states)


def test_nothing_is_sent_while_nothing_moves(server: viser.ViserServer, monkeypatch: pytest.MonkeyPatch) -> None:
    env = rcs.make("PickToy", robot="xarm7")
    env.reset(seed=0)
    scene = BrowserScene(server, env.simulation.world, list(env.robots.values()))
    sent: list[object] = []
    monkeypatch.setattr(server._websock_server, "queue_message", sent.append)
    scene.show()
    assert not sent
    env.step({key: np.zeros_like(box.low) for key, box in env.action_space.items()})
    scene.show()
    assert sent
    env.close()


def test_another_colour_is_shown_after_a_reset(server: viser.ViserServer) -> None:
    env = rcs.make("PickCuboid", robot="fr3", randomisation=True)
    env.reset(seed=0)
    scene = BrowserScene(server, env.simulation.world, list(env.robots.values()))

    def colours() -> dict[str, tuple[int, ...]]:
        nodes = server.scene._handle_from_node_name
        return {name: node.color for name, node in nodes.items() if isinstance(node, viser.MeshHandle)}

    before = colours()
    env.reset(seed=1)
    scene.rebuild()
    after = colours()
    assert after.keys() == before.keys()
    assert after != before
    env.close()


def test_many_copies_are_refused(server: viser.ViserServer) -> None:
    envs = rcs.make_vec("PickCuboid", copies=2)
    with pytest.raises(InvalidSetup, match="one copy"):
        BrowserScene(server, envs.simulation.world, [])
    envs.close()


def test_arms_are_looked_at_from_as_much_farther_as_they_stand_apart(server: viser.ViserServer) -> None:
    far: list[float] = []
    for task, robot in (("PickCuboid", "fr3"), ("LiftBar", "dual_fr3")):
        with rcs.make(task, robot=robot) as env:
            BrowserScene(server, env.simulation.world, list(env.robots.values()))
            bases = np.array([one.base_in_scene.translation for one in env.robots.values()])
        start = server.initial_camera
        far.append(float(np.linalg.norm(np.subtract(start.position, start.look_at))))
    assert np.ptp(bases, axis=0).max() > 0.3
    assert far[1] - far[0] == pytest.approx(DISTANCE * np.ptp(bases, axis=0).max() / 2, rel=1e-3)
