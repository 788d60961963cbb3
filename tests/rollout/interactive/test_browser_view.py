"""The page: what it asks for is done by the session's thread, and it is served to this machine alone."""

from __future__ import annotations

import asyncio
import sys
import time
import urllib.request
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, Protocol

import av
import numpy as np
import pytest
import viser

from rcs.envs.setup import Setup
from rcs.errors import InvalidSetup, MissingDependency
from rcs.rollout.interactive.browser_view import BrowserView
from rcs.rollout.interactive.page import start_server
from rcs.rollout.interactive.session import Session, playable
from rcs.spatial import distance, xyzw_to_wxyz


@pytest.fixture
def view() -> Iterator[BrowserView]:
    """A page of an environment that does not wait for the wall clock."""
    session = Session(replace(playable(Setup(task="PickCuboid", reward="sparse")), stepping="async"))
    with BrowserView(session, port=0) as view:
        yield view
    view.session.close()


def server_of(view: BrowserView) -> viser.ViserServer:
    assert view._server is not None
    return view._server


def control(view: BrowserView, label: str) -> Any:
    """Return a control of the panel by its label."""
    handles = server_of(view).gui._gui_input_handle_from_uuid.values()
    (found,) = (handle for handle in handles if getattr(handle, "label", None) == label)
    return found


def give(view: BrowserView, label: str, value: Any) -> None:
    """Give a control a value as a page does, or press a button, and have the session see it."""
    handle, server = control(view, label), server_of(view)
    handle._impl.value = value
    event = viser.GuiEvent(client=None, client_id=7, target=handle)
    for callback in handle._impl.update_cb:
        asyncio.run_coroutine_threadsafe(callback(event), server.get_event_loop()).result(10)
    view.update()


def words(view: BrowserView) -> str:
    """Return the text at the top of the panel as it is now."""
    panel = view._panel
    assert panel is not None
    panel._next_text = 0.0
    panel.show()
    return panel._status.content


def drag(view: BrowserView, robot: str, pose: np.ndarray) -> None:
    """Drag the target of a robot to a pose in the scene as a page does."""
    server = server_of(view)
    gizmo = server.scene.get_handle_by_name(f"/targets/{robot}")
    assert isinstance(gizmo, viser.TransformControlsHandle)
    gizmo._impl.position, gizmo._impl.wxyz = pose[:3].copy(), xyzw_to_wxyz(pose[3:])
    event = viser.TransformControlsEvent(client=None, client_id=7, target=gizmo, phase="update")
    for callback in gizmo._impl_aux.update_cb:
        asyncio.run_coroutine_threadsafe(callback(event), server.get_event_loop()).result(10)
    view.update()


def test_a_dragged_target_is_where_the_arm_goes(view: BrowserView) -> None:
    guide = view.session.guides["fr3"]
    pose = guide.tcp_in_scene + np.array([0.05, 0.1, -0.1, 0, 0, 0, 0])
    drag(view, "fr3", pose)
    for _ in range(90):
        view.update()
    assert distance(guide.tcp_in_scene, pose)[0] < 2e-3
    sliders = [control(view, joint).value for joint in guide.robot.arm.joints]
    view._panel._next_text = 0.0
    view.update()
    sliders = [control(view, joint).value for joint in guide.robot.arm.joints]
    np.testing.assert_allclose(sliders, view.session.observation["joints"], atol=0.01)


def test_a_slider_of_a_joint_moves_the_joint_and_the_target_goes_along(view: BrowserView) -> None:
    guide = view.session.guides["fr3"]
    give(view, guide.robot.arm.joints[0], 0.5)
    for _ in range(90):
        view.update()
    assert view.session.observation["joints"][0] == pytest.approx(0.5, abs=2e-3)
    gizmo = server_of(view).scene.get_handle_by_name("/targets/fr3")
    np.testing.assert_allclose(gizmo.position, guide.tcp_in_scene[:3], atol=2e-3)


def test_the_buttons_pause_step_play_and_begin_episodes(view: BrowserView) -> None:
    session = view.session
    give(view, "Time", "Pause")
    steps = session.steps
    view.update()
    assert session.steps == steps
    assert "**paused**" in words(view)
    give(view, "Time", "Step")
    assert session.steps == steps + 1
    give(view, "Time", "Play")
    assert session.steps > steps + 1
    control(view, "Seed").value = 11
    give(view, "Begin", "Reset")
    assert session.seed == 11
    give(view, "Begin", "Next seed")
    assert (session.seed, control(view, "Seed").value) == (12, 12)


def test_what_is_said_of_the_buttons_at_the_end_is_what_they_do(view: BrowserView) -> None:
    session = view.session
    session.is_over = True
    assert "*Reset* repeats it, *Next seed* begins another one" in words(view)
    before = session.seed
    give(view, "Begin", "Reset")
    assert session.seed == before


def test_the_gripper_follows_its_slider(view: BrowserView) -> None:
    give(view, "Opening", 0.3)
    for _ in range(60):
        view.update()
    assert view.session.observation["gripper"][0] == pytest.approx(0.3, abs=0.02)


def test_the_expert_shows_how_it_is_done_and_the_target_is_hidden_meanwhile(view: BrowserView) -> None:
    give(view, "Agent acts", True)
    gizmo = server_of(view).scene.get_handle_by_name("/targets/fr3")
    words_at_the_end = ""
    for _ in range(600):
        view.update()
        if view.session.is_over:
            words_at_the_end = words(view)
            break
    assert "**success**" in words_at_the_end
    assert "reward 1.000" in words_at_the_end
    assert not gizmo.visible


def test_a_fault_is_told_and_the_button_recovers(view: BrowserView, monkeypatch: pytest.MonkeyPatch) -> None:
    assert not control(view, "Recover").visible
    with monkeypatch.context() as broken:
        broken.setattr(view.session.env.stack, "faults", lambda: {"fr3": "collision at joint 4"})
        view.update()
    assert "collision at joint 4" in words(view)
    assert control(view, "Recover").visible
    give(view, "Recover", True)
    assert "**running**" in words(view)
    assert not control(view, "Recover").visible


def test_an_error_of_a_request_is_shown_and_the_session_goes_on(view: BrowserView) -> None:
    def fail() -> None:
        raise InvalidSetup("no such robot")

    view.submit(fail)
    view.update()
    assert "> InvalidSetup: no such robot" in words(view)
    steps = view.session.steps
    view.update()
    assert view.session.steps > steps


def test_contact_forces_are_shown_when_wanted(view: BrowserView) -> None:
    give(view, "Contact forces", True)
    for _ in range(10):
        view.update()
    assert server_of(view).scene.get_handle_by_name("/scene/contacts").visible
    give(view, "Contact forces", False)
    assert not server_of(view).scene.get_handle_by_name("/scene/contacts").visible


def test_the_page_is_served_here_alone_and_opens_no_tunnel(view: BrowserView) -> None:
    assert view.url.startswith("http://localhost:")
    with urllib.request.urlopen(view.url, timeout=10) as page:
        assert b"<html" in page.read()
    assert server_of(view)._websock_server._host == "127.0.0.1"
    assert server_of(view).request_share_url() is None


def test_a_port_that_is_taken_leads_to_the_next_one() -> None:
    first = start_server("127.0.0.1", 0)
    second = start_server("127.0.0.1", first.get_port())
    assert second.get_port() > first.get_port()
    first.stop()
    second.stop()


def test_without_viser_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "viser", None)
    with pytest.raises(MissingDependency, match=r"pip install 'robot-control-stack\[view\]'"):
        start_server("127.0.0.1", 0)


def test_closing_twice_is_harmless(view: BrowserView) -> None:
    view.close()
    view.close()


class Browser(Protocol):
    errors: list[str]

    def open(self, address: str) -> None: ...
    def run(self, script: str) -> Any: ...
    def resize(self, width: int, height: int) -> None: ...
    def call(self, method: str, **params: Any) -> dict[str, Any]: ...
    def screenshot(self, path: Path) -> None: ...


@pytest.mark.browser
def test_two_pages_show_the_scene_use_no_network_and_may_be_closed(
    view: BrowserView, chromium: Browser, tmp_path: Path
) -> None:
    chromium.errors.clear()
    chromium.resize(640, 400)  # quick to draw without a GPU
    chromium.open(view.url)
    server = server_of(view)
    view.session.is_playing = False

    def until(is_true: Callable[[], bool]) -> None:
        end = time.monotonic() + 120
        while not is_true():
            assert time.monotonic() < end, f"errors: {chromium.errors}"
            view.update()

    until(lambda: len(server.get_clients()) == 1)
    second = chromium.call("Target.createTarget", url=view.url, newWindow=True)["targetId"]
    until(lambda: len(server.get_clients()) == 2)
    chromium.call("Target.closeTarget", targetId=second)
    until(lambda: len(server.get_clients()) == 1)
    assert "PickCuboid on fr3" in chromium.run("document.body.innerText")
    loaded: list[str] = chromium.run("performance.getEntriesByType('resource').map((entry) => entry.name)")
    assert not [name for name in loaded if not name.startswith((view.url, "data:", "blob:"))]

    def colours() -> int:
        """How many colours the left third of the page has, where the scene is."""
        chromium.screenshot(tmp_path / "page.png")
        with av.open(str(tmp_path / "page.png")) as file:
            picture = next(file.decode(video=0)).to_ndarray(format="rgb24")
        return len(np.unique(picture[:, : picture.shape[1] // 3].reshape(-1, 3), axis=0))

    until(lambda: colours() > 500)
    assert not chromium.errors
