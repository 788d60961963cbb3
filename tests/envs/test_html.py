"""An environment in a notebook cell."""

from __future__ import annotations

import base64
import re

import numpy as np
import pytest
from rcs_data.codec import decode_jpeg

import rcs
from rcs._core import Renderer
from rcs.envs.html import SIZE
from rcs.errors import MissingDependency


def shown(env: object) -> str:
    return env._repr_html_()  # type: ignore[attr-defined]


@pytest.mark.gl
def test_a_notebook_shows_setup_stack_and_a_picture() -> None:
    env = rcs.make("PickCuboid", robot="fr3", frequency=20.0)
    env.reset(seed=0)
    page = shown(env)
    for text in ("<h4>rcs PickCuboid with fr3</h4>", "<th>frequency</th><td>20.0</td>", "BinaryGripper"):
        assert text in page
    assert "<th>depth</th>" not in page, "fields at their defaults are not listed"
    [source] = re.findall(r'src="data:image/jpeg;base64,([^"]+)"', page)
    picture = decode_jpeg(base64.b64decode(source), (SIZE[1], SIZE[0], 3))
    assert np.ptp(picture) > 100
    env.close()


@pytest.mark.gl
def test_looking_changes_nothing() -> None:
    one, other = (rcs.make("PickCuboid") for _ in range(2))
    one.reset(seed=1)
    other.reset(seed=1)
    shown(one)
    for _ in range(3):
        action = one.action_space.sample()
        observations = [env.step(action)[0] for env in (one, other)]
        shown(one)
        np.testing.assert_array_equal(observations[0]["joints"], observations[1]["joints"])
    np.testing.assert_array_equal(one.simulation.world.core.get_state(0), other.simulation.world.core.get_state(0))


def test_there_is_no_picture_of_real_devices() -> None:
    env = rcs.make("Free", hardware="fake")
    assert "FakeArm" in shown(env) or "ArmPort" in shown(env)
    assert "<img" not in shown(env)


def test_there_is_no_picture_without_opengl(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object, **__: object) -> Renderer:
        raise MissingDependency("There is no OpenGL.")

    monkeypatch.setattr("rcs.sim.viewer.Renderer", refuse)
    env = rcs.make("Free")
    env.reset(seed=0)
    assert "<img" not in shown(env)


def test_what_a_setup_says_is_text_and_no_markup() -> None:
    env = rcs.make("Free", hardware="fake", cameras=rcs.Cameras(calibration=None))
    title = rcs.make("Free", hardware="fake")
    title._title = "<script>"
    assert "<script>" not in shown(title)
    assert shown(env).startswith("<h4>rcs Free")
