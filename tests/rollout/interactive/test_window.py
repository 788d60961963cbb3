"""MuJoCo's viewer on a session: what its panels set leads the robots; and it opens where there is a display."""

from __future__ import annotations

import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rcs.envs.setup import Setup
from rcs.errors import MissingDependency
from rcs.rollout.interactive.session import Session, playable
from rcs.rollout.interactive.window import ENTER, RIGHT, SPACE, Window
from rcs.sim.viewer import Viewer


class PanelOnly:
    """Stands for MuJoCo's viewer, whose panels write into the world's data when it is synchronised."""

    is_running = True

    def __init__(self, session: Session) -> None:
        self.session = session
        self.controls: dict[str, float] = {}
        self.is_reset = False
        self.told = ""

    def write(self, left: str, right: str) -> None:
        self.told = right

    def sync(self) -> None:
        world = self.session.world
        for name, value in self.controls.items():
            world.ctrl[world.model.actuator(name).id] = value
        if self.is_reset:
            world.qpos[...], world.time[...] = world.model.qpos0, 0.0
        self.controls, self.is_reset = {}, False


@pytest.fixture
def played(monkeypatch: pytest.MonkeyPatch) -> tuple[Window, PanelOnly]:
    session = Session(replace(playable(Setup(task="LiftBar", robot="dual_fr3")), stepping="async"))
    window = Window(session)
    panel = PanelOnly(session)
    monkeypatch.setattr(window, "_viewer", panel)
    return window, panel


def turn(window: Window, times: int) -> None:
    for _ in range(times):
        window._next_sync = 0.0
        window.update()


def test_a_slider_of_the_panel_leads_its_joint_through_the_environments_layers(
    played: tuple[Window, PanelOnly],
) -> None:
    window, panel = played
    session = window.session
    turn(window, 2)
    right = session.observation["right"]["joints"]
    panel.controls = {"left/joint1": 0.5, "left/gripper/fingers": 0.0}
    turn(window, 1)
    assert abs(session.observation["left"]["joints"][0]) < 0.1, "it does not jump"
    turn(window, 90)
    assert session.observation["left"]["joints"][0] == pytest.approx(0.5, abs=5e-3)
    assert session.observation["left"]["gripper"][0] < 0.05
    np.testing.assert_allclose(session.observation["right"]["joints"], right, atol=5e-3)
    session.close()


def test_the_panels_own_reset_begins_an_episode_also_at_its_very_start(played: tuple[Window, PanelOnly]) -> None:
    window, panel = played
    session = window.session
    turn(window, 3)
    for seed in (1, 2):  # the second time nothing has moved yet
        session.is_playing = False
        panel.is_reset = True
        turn(window, 1)
        assert (session.seed, session.steps) == (seed, 0)
        home = session.env.robots["left"].arm.home
        np.testing.assert_allclose(session.world.qpos[session.env.simulation.robots[0].layout.qpos], home, atol=0.02)
    session.close()


def test_keys_pause_step_and_recover(played: tuple[Window, PanelOnly], monkeypatch: pytest.MonkeyPatch) -> None:
    window, panel = played
    session = window.session
    window._keys.put(SPACE)
    turn(window, 3)
    assert session.steps == 0
    window._keys.put(RIGHT)
    turn(window, 3)
    assert session.steps == 1
    with monkeypatch.context() as broken:
        broken.setattr(session.env.stack, "faults", lambda: {"left": "collision"})
        window._keys.put(RIGHT)
        turn(window, 1)
    assert "collision" in panel.told
    window._keys.put(ENTER)
    turn(window, 1)
    assert not session.problem
    session.close()


def test_without_a_display_the_page_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rcs.sim.viewer.has_display", lambda: False)
    with (
        Session(playable(Setup(task="Free"))) as session,
        pytest.raises(MissingDependency, match="rcs sim --browser"),
        Viewer(session.world),
    ):
        pass


@pytest.mark.gl
def test_it_opens_on_a_display_and_ends_with_it(tmp_path: Path) -> None:
    if shutil.which("xvfb-run") is None:
        pytest.skip("There is no xvfb-run, which gives a display to a program.")
    program = """
from rcs.envs.setup import Setup
from rcs.rollout.interactive.session import Session, playable
from rcs.rollout.interactive.window import Window

with Session(playable(Setup(task="PickCuboid"))) as session, Window(session) as window:
    assert window._viewer.is_running
    while session.steps < 10:
        window.update()
assert not window._viewer.is_running
print("ended")
"""
    command = ["xvfb-run", "-a", "-s", "-screen 0 640x480x24", sys.executable, "-c", program]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert (ended.returncode, ended.stdout) == (0, "ended\n"), ended.stderr
