"""The page: what it asks for is done by the session's thread, and it is served to this machine alone."""

from __future__ import annotations

import asyncio
import sys
import threading
import urllib.error
import urllib.request
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from rcs_data import Dataset

from rcs.envs import Env
from rcs.envs.observers.recorder import Recorder
from rcs.envs.setup import Setup
from rcs.errors import InvalidSetup, MissingDependency
from rcs.rollout.interactive.browser_view import BrowserView
from rcs.rollout.interactive.page import start_server
from rcs.rollout.interactive.session import Session, playable
from rcs.spatial import distance
from rcs.teleop import Operator
from tests.rollout.interactive.driven_page import control, drag, give, hear, server_of, update, words
from tests.teleop.scripted_device import ScriptedDevice, held


@pytest.fixture
def view() -> Iterator[BrowserView]:
    """A page of an environment that does not wait for the wall clock."""
    session = Session(replace(playable(Setup(task="PickCuboid", reward="sparse")), stepping="async"))
    with BrowserView(session, port=0) as view:
        yield view
    view.session.close()


def test_a_dragged_target_is_where_the_arm_goes(view: BrowserView) -> None:
    guide = view.session.guides["fr3"]
    pose = guide.tcp_in_scene + np.array([0.05, 0.1, -0.1, 0, 0, 0, 0])
    drag(view, "fr3", pose)
    update(view, 90)
    assert distance(guide.tcp_in_scene, pose)[0] < 2e-3
    sliders = [control(view, joint).value for joint in guide.robot.arm.joints]
    view._panel._next_text = 0.0
    view.update()
    sliders = [control(view, joint).value for joint in guide.robot.arm.joints]
    np.testing.assert_allclose(sliders, view.session.observation["joints"], atol=0.01)


def test_a_slider_of_a_joint_moves_the_joint_and_the_target_goes_along(view: BrowserView) -> None:
    guide = view.session.guides["fr3"]
    give(view, guide.robot.arm.joints[0], 0.5)
    update(view, 90)
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
    update(view, 60)
    assert view.session.observation["gripper"][0] == pytest.approx(0.3, abs=0.02)


def test_the_expert_shows_how_it_is_done_and_the_target_is_hidden_meanwhile(view: BrowserView) -> None:
    give(view, "Agent acts", True)
    gizmo = server_of(view).scene.get_handle_by_name("/targets/fr3")
    words_at_the_end = ""
    for _ in range(600):
        update(view)
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


IMAGE = "<img src=x onerror=alert(1)>"


def test_why_a_gate_has_refused_is_shown(view: BrowserView) -> None:
    view.session.info = {**view.session.info, "refused": "the hand is near the table"}
    assert "> Refused: the hand is near the table" in words(view)


def test_words_of_a_fault_and_an_instruction_are_shown_and_not_rendered(
    view: BrowserView, monkeypatch: pytest.MonkeyPatch
) -> None:
    engine: Any = view.session.env._engine
    engine.instruction = f"pick {IMAGE}"
    with monkeypatch.context() as broken:
        broken.setattr(view.session.env.stack, "faults", lambda: {"side": f"404\n{IMAGE}"})
        view.update()
    shown = words(view)
    assert "<" not in shown
    assert "**pick &lt;img src=x onerror=alert" in shown
    assert "> side: 404 &lt;img src=x onerror=alert" in shown


def test_an_error_of_a_request_is_shown_and_the_session_goes_on(view: BrowserView) -> None:
    def fail() -> None:
        raise InvalidSetup("no such robot")

    view.submit(fail)
    view.update()
    assert "> InvalidSetup: no such robot" in words(view)
    steps = view.session.steps
    view.update()
    assert view.session.steps > steps


def test_the_page_is_served_here_alone_and_opens_no_tunnel(view: BrowserView) -> None:
    assert view.url.startswith("http://localhost:")
    with urllib.request.urlopen(view.url, timeout=10) as page:
        assert b"<html" in page.read()
    assert server_of(view)._websock_server._host == "127.0.0.1"
    assert server_of(view).request_share_url() is None


def test_a_port_that_is_taken_leads_to_the_next_one(view: BrowserView) -> None:
    port = int(view.url.rpartition(":")[2])
    with BrowserView(view.session, port=port) as second:
        assert int(second.url.rpartition(":")[2]) > port


def test_without_viser_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "viser", None)
    with pytest.raises(MissingDependency, match=r"pip install 'robot-control-stack\[view\]'"):
        start_server()


def test_one_page_leads_and_when_it_is_gone_the_robot_stays_and_the_next_leads(view: BrowserView) -> None:
    guide, server = view.session.guides["fr3"], server_of(view)
    pose = guide.tcp_in_scene + np.array([0.05, 0.1, -0.1, 0, 0, 0, 0])
    drag(view, "fr3", pose)
    assert view.leader == 7
    hear(view, 8)
    view.submit(lambda: view.session.reset(99), 8)
    update(view)
    assert "Another page leads" in words(view)
    assert view.session.seed == 0
    update(view, 5)
    for gone in (8, 7):  # the one that only shows changes nothing
        hear(view, 7)
        assert view.leader == 7
        for callback in server._client_disconnect_cb:
            asyncio.run(_called(callback, SimpleNamespace(client_id=gone)))
        view.update()
    assert view.leader is None
    for _ in range(20):
        view.update()
    stopped = guide.tcp_in_scene
    for _ in range(30):
        view.update()
    assert distance(guide.tcp_in_scene, stopped)[0] < 1e-4
    assert distance(guide.tcp_in_scene, pose)[0] > 0.05
    hear(view, 8)
    view.submit(lambda: view.session.reset(4), 8)
    view.update()
    assert (view.leader, view.session.seed) == (8, 4)


async def _called(callback: Any, client: Any) -> None:
    if (waits := callback(client)) is not None:
        await waits


def test_the_state_of_a_person_at_a_device_is_shown_and_what_is_wrong() -> None:
    def operator(env: Env) -> Operator:
        return Operator(env, ScriptedDevice(lambda t: held(np.full(7, np.nan))), has_thread=False)

    with Session(replace(playable(Setup(task="Free")), stepping="async"), agent=operator) as session:
        session.let_agent(True)
        with BrowserView(session, port=0) as view:
            view.update()
            assert "ScriptedDevice: held, no reading yet; left out: not finite" in words(view)


def test_a_person_at_a_device_leads_on_when_the_page_that_led_is_gone() -> None:
    def operator(env: Env) -> Operator:
        return Operator(env, ScriptedDevice(lambda t: held(None)), has_thread=False)

    with Session(replace(playable(Setup(task="Free")), stepping="async"), agent=operator) as session:
        session.let_agent(True)
        with BrowserView(session, port=0) as view:
            hear(view, 7)
            view.submit(lambda: None, 7)
            view.update()
            assert view.leader == 7
            hear(view, 7, is_seen=False)
            view.update()
            assert "cut off: the device leads on" in words(view)


def test_takes_are_made_with_buttons_and_listed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    session = Session(replace(playable(Setup(task="PickCuboid")), stepping="async"), record_into=tmp_path / "set")
    with session, BrowserView(session, port=0) as view:
        panel = view._panel
        assert panel is not None
        assert panel._takes is not None
        give(view, "Take", "Success")
        assert "no open episode" in words(view)
        for verdict in ("Success", "Discard", "Failure"):
            give(view, "Take", "Start")
            view.update()
            words(view)
            assert "recording" in panel._takes.content
            give(view, "Take", verdict)
        words(view)
        assert panel._takes.content == (
            "000001: failure, 2 rows  \n000001: discarded, 2 rows  \n000000: success, 2 rows"
        )
        assert control(view, "Seed").value == 2
        monkeypatch.setattr(Recorder, "dropped", 3)
        give(view, "Take", "Start")
        words(view)
        assert panel._takes.content.startswith("**000002: recording, 3 images or rows dropped**")
        give(view, "Take", "Discard")
    assert [one.success for one in Dataset.open(tmp_path / "set").episodes] == [True, False]


def test_what_is_shown_leaves_the_waiters_of_viser_to_its_own_thread(view: BrowserView) -> None:
    class Changing:
        """Waiters that another thread changes."""

        def __iter__(self) -> Iterator[Any]:
            changed.append(threading.current_thread())
            raise RuntimeError("deque mutated during iteration")

    changed: list[threading.Thread] = []
    event = server_of(view)._websock_server._broadcast_buffer.message_event
    event.clear()
    event._waiters = Changing()  # type: ignore[attr-defined]  # pyright: ignore[reportAttributeAccessIssue]
    words(view)
    give(view, "Opening", 0.4)
    assert threading.current_thread() not in changed


def test_closing_twice_is_harmless(view: BrowserView) -> None:
    view.close()
    view.close()
