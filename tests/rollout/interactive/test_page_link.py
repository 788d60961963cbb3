"""Pages that lead: by keys with exact releases, as long as they are heard, and one at a time."""

from __future__ import annotations

import json
import random
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from websockets.exceptions import WebSocketException
from websockets.sync.client import connect

from rcs.envs.setup import Setup
from rcs.rollout.interactive.browser_view import BrowserView
from rcs.rollout.interactive.page_link import PATH, VALID_FOR, PageKeys
from rcs.rollout.interactive.session import Session, playable
from rcs.teleop import Keyboard
from tests.rollout.asking import Asking
from tests.rollout.interactive.driven_page import control, drag, give, hear, update, words

BRAKING = 5
"""Steps of 1/30 s within which a robot that nobody leads is at rest: 0.1 s, and one from before the law was known."""


@pytest.fixture
def view() -> Iterator[BrowserView]:
    session = Session(replace(playable(Setup(task="Free")), stepping="async"))
    with BrowserView(session, port=0) as view:
        yield view
    view.session.close()


def place(view: BrowserView) -> np.ndarray:
    return np.array(view.session.observation["tquat"][:3])


def way_after_braking(view: BrowserView) -> float:
    """Return how far the TCP still goes after the time for braking, while nobody speaks [m]."""
    for _ in range(BRAKING):
        view.update()
    start = place(view)
    for _ in range(20):
        view.update()
    return float(np.linalg.norm(place(view) - start))


def lead_by_key(view: BrowserView, key: str) -> None:
    """Press a key and hold it until the robot moves; anew where a busy machine holds threads up for too long."""
    for _ in range(20):
        update(view, 3)
        start = place(view)
        update(view, 12, keys=(key,))
        if np.linalg.norm(place(view) - start) > 0.01:
            return
    pytest.fail(words(view))


def test_keys_lead_as_long_as_they_are_held_and_to_where_they_say(view: BrowserView) -> None:
    give(view, "Keys lead", "fr3")
    assert "keys (0.10 m/s): held" in words(view)
    lead_by_key(view, "d")
    update(view, 15)  # released
    stopped = place(view)
    update(view, 15)
    assert np.linalg.norm(place(view) - stopped) < 1e-4
    lead_by_key(view, "a")
    way = place(view) - stopped
    assert way[1] > 0.01 > np.abs(way[[0, 2]]).max()
    give(view, "Keys lead", "no robot")
    assert view.session.operator is None
    update(view, 15)
    stopped = place(view)
    update(view, 15, keys=("a",))
    assert np.linalg.norm(place(view) - stopped) < 1e-4


def test_keys_lead_nothing_unless_that_is_wanted_and_what_was_held_before_is_not_meant(view: BrowserView) -> None:
    update(view, 10)
    start = place(view)
    update(view, 20, keys=("w",))
    hear(view, 7, keys=("w",))
    give(view, "Keys lead", "fr3")
    update(view, 20, keys=("w",))
    assert np.linalg.norm(place(view) - start) < 1e-3


def test_a_page_that_is_hidden_holds_at_once_and_one_that_is_silent_soon(view: BrowserView) -> None:
    give(view, "Keys lead", "fr3")
    for hide in (True, False):
        lead_by_key(view, "r" if hide else "f")
        if hide:
            hear(view, 7, is_seen=False)
        else:
            time.sleep(VALID_FOR)
        assert way_after_braking(view) < 1e-3
        assert view.leader is None
        update(view, 10, keys=("r",))  # it is back, with a key that is still held
        start = place(view)
        update(view, 10, keys=("r",))
        assert np.linalg.norm(place(view) - start) < 1e-3


def test_a_target_is_left_where_the_robot_is_when_its_page_is_silent(view: BrowserView) -> None:
    for _ in range(20):
        goal = view.session.guides["fr3"].tcp_in_scene
        goal[1] += 0.2 if goal[1] < 0.1 else -0.3
        drag(view, "fr3", goal)
        start = place(view)
        update(view, 12)
        if np.linalg.norm(place(view) - start) > 0.01:
            break
    time.sleep(VALID_FOR)
    assert way_after_braking(view) < 1e-3
    assert np.linalg.norm(place(view) - goal[:3]) > 0.02
    assert "hidden, closed or cut off" in words(view)


def test_keys_of_a_second_page_lead_nothing_until_the_first_is_gone(view: BrowserView) -> None:
    give(view, "Keys lead", "fr3")
    hear(view, 8)
    update(view, 10)
    start = place(view)
    for _ in range(10):
        hear(view, 8, keys=("w",))
        update(view)
    assert np.linalg.norm(place(view) - start) < 1e-3
    assert view.leader == 7
    assert "Another page leads" in words(view)
    time.sleep(VALID_FOR)
    for _ in range(10):  # the first is silent; the key of the second has to be pressed anew
        hear(view, 8, keys=("w",))
        view.update()
    assert np.linalg.norm(place(view) - start) < 1e-3
    hear(view, 8)
    view.update()
    hear(view, 8, keys=("w",))
    view.update()
    view.update()
    assert view.leader == 8


def test_keys_that_were_pressed_on_a_page_that_only_showed_are_not_meant(view: BrowserView) -> None:
    give(view, "Keys lead", "fr3")
    for _ in range(3):
        hear(view, 8, keys=("=",))
        hear(view, 8)
        update(view)
    hear(view, 7, is_seen=False)
    view.update()
    assert view.leader is None
    hear(view, 8)
    view.submit(lambda: None, 8)
    for _ in range(20):
        hear(view, 8)
        time.sleep(0.005)
        view.update()
    assert view.leader == 8
    assert "0.10 m/s" in words(view)


def test_a_page_that_is_too_slow_to_be_heard_can_still_pause(view: BrowserView) -> None:
    hear(view, 7)
    time.sleep(VALID_FOR)
    link = view._link
    assert link is not None and not link.hears(7)
    view._ask(lambda: setattr(view.session, "is_playing", False), 7)
    view.update()
    assert not view.session.is_playing


def test_a_page_that_was_never_heard_cannot_lead(view: BrowserView) -> None:
    view.submit(lambda: view.session.reset(5), 9)
    view.update()
    assert view.session.seed == 0
    assert "not heard" in words(view)


def test_what_acts_is_shown_and_an_agent_takes_the_robot_from_the_keys() -> None:
    session = Session(replace(playable(Setup(task="PickCuboid")), stepping="async"))
    with session, BrowserView(session, port=0) as view:
        give(view, "Keys lead", "fr3")
        give(view, "Agent acts", True)
        words(view)
        assert (control(view, "Keys lead").value, control(view, "Agent acts").value) == ("no robot", True)
        give(view, "Keys lead", "fr3")
        words(view)
        assert (control(view, "Keys lead").value, control(view, "Agent acts").value) == ("fr3", False)


def test_when_the_page_that_led_is_gone_the_agent_acts_no_longer() -> None:
    session = Session(replace(playable(Setup(task="PickCuboid")), stepping="async"))
    with session, BrowserView(session, port=0) as view:
        give(view, "Agent acts", True)
        update(view, 20)
        time.sleep(VALID_FOR)
        view.update()
        assert (view.leader, session.agent) == (None, None)
        assert way_after_braking(view) < 1e-3
        assert "the robots stay" in words(view)
        assert not control(view, "Agent acts").value


def test_what_an_agent_asks_for_in_vain_is_told_and_the_session_goes_on() -> None:
    setup = replace(playable(Setup(task="Free", relative="absolute")), stepping="async")
    session = Session(setup, agent=lambda env: Asking(env, {3: "success"}, rate=10.0))
    with session, BrowserView(session, port=0) as view:
        session.let_agent(True)
        for _ in range(5):
            view.update()
        assert "> WrongOrder: Nothing is recorded" in words(view)
        assert (session.verdict, session.steps) == ("running", 5)


def test_strangers_and_damaged_messages_are_not_heard(view: BrowserView) -> None:
    link = view._link
    assert link is not None
    host = view.url.replace("http", "ws")
    with connect(f"{host}{PATH}?stranger") as stranger, pytest.raises(WebSocketException):
        stranger.recv(timeout=20)
    with pytest.raises(WebSocketException, match="403"):
        connect(f"{host}{PATH}?x", origin="http://elsewhere.example").close()
    token = link.admit(9).partition('"token": "')[2].partition('"')[0]
    with connect(f"{host}{PATH}?{token}", origin=view.url) as page:
        assert json.loads(page.recv(timeout=20)) == {"leads": False}
        random_ = random.Random(5)
        good = json.dumps({"time": 5.0, "is_seen": True, "keys": ["w"]}).encode()
        for number in range(2000):
            noise = random_.randbytes(30) if number % 2 else good[: random_.randrange(len(good))]
            page.send(noise)
        end = time.monotonic() + 20
        while link.damaged < 2000:
            assert time.monotonic() < end
            time.sleep(0.01)
        assert not link.hears(9)
        page.send(good)
        while not link.hears(9):
            assert time.monotonic() < end
        page.send(good.replace(b"w", b"F5").replace(b"5.0", b"6.0"))  # no key that leads
        while link.damaged < 2001:
            assert time.monotonic() < end
            time.sleep(0.01)
    assert link._pages[9].held == set()


class Browser:
    """A page in Chromium with real keys."""

    def __init__(self, chromium: Any, view: BrowserView) -> None:
        self._chromium, self._view = chromium, view

    def until(self, is_true: Callable[[], bool]) -> None:
        end = time.monotonic() + 120
        while not is_true():
            assert time.monotonic() < end, f"{self._chromium.errors}, {words(self._view)}"
            self._view.update()
            time.sleep(0.005)  # the page is served by a thread beside this one

    def go_on(self, seconds: float, is_true: Callable[[], bool] = lambda: False) -> bool:
        end = time.monotonic() + seconds
        while time.monotonic() < end and not is_true():
            self._view.update()
            time.sleep(0.005)  # the page is served by a thread beside this one
        return is_true()

    def key(self, kind: str, letter: str) -> None:
        code = f"Key{letter.upper()}"
        self._chromium.call("Input.dispatchKeyEvent", type=kind, key=letter, code=code)

    def lead(self, letter: str) -> None:
        """Press a key and hold it until the robot follows."""
        for _ in range(30):
            self.key("keyUp", letter)
            self.go_on(0.3)
            self.key("keyDown", letter)
            start = place(self._view)
            if self.go_on(1.5, lambda start=start: bool(np.linalg.norm(place(self._view) - start) > 0.005)):
                return
        pytest.fail(f"{words(self._view)}, {self._view._link and self._view._link._pages}")


HIDE = """Object.defineProperty(document, 'visibilityState', { value: 'hidden', configurable: true });
document.dispatchEvent(new Event('visibilitychange'))"""


@pytest.mark.slow
@pytest.mark.browser
def test_the_whole_page_is_heard_and_offers_keys(chromium: Any, tmp_path: Path) -> None:
    session = Session(playable(Setup(task="Free")))  # in real time: a page without a GPU cannot draw every step
    with session, BrowserView(session, port=0) as view:
        page, link = Browser(chromium, view), view._link
        assert link is not None
        chromium.errors.clear()
        chromium.resize(480, 640)
        chromium.open(view.url)
        page.until(lambda: any(own.is_seen for own in link._pages.values()))
        page.until(lambda: "Keys lead" in chromium.run("document.body.innerText"))
        give(view, "Keys lead", "fr3")
        page.until(lambda: "space: gripper" in chromium.run("document.body.innerText"))
        chromium.screenshot(tmp_path / "keys.png")
        assert not chromium.errors


# The last one: Chromium keeps a page hidden after it was frozen, and all that it opens later.
@pytest.mark.slow
@pytest.mark.browser
def test_keys_in_a_browser_lead_until_they_are_released_or_the_page_is_hidden_or_frozen(chromium: Any) -> None:
    session = Session(playable(Setup(task="Free")))
    with session, BrowserView(session, port=0) as view:
        page, link = Browser(chromium, view), view._link
        assert link is not None
        chromium.errors.clear()
        # The script alone, beside words at the page's address: drawing without a GPU, a page is too busy to be heard.
        chromium.open(f"{view.url}{PATH}")
        chromium.run(f"new Function({json.dumps(link.admit(7))})()")
        page.until(lambda: link.hears(7))
        view.submit(lambda: session.let_keys(Keyboard(keys=PageKeys(link)), "fr3"), 7)
        page.until(lambda: session.operator is not None)
        operator = session.operator
        assert operator is not None
        page.lead("d")
        page.key("keyUp", "d")
        page.until(lambda: operator.states["right"] != "engaged")
        assert way_after_braking(view) < 1e-3
        for hide in (HIDE, "window.dispatchEvent(new Event('blur'))"):
            page.lead("a")
            chromium.run(hide)
            page.until(lambda: operator.states["right"] != "engaged")
            assert way_after_braking(view) < 1e-3
            chromium.run(HIDE.replace("hidden", "visible"))
        page.lead("a")
        chromium.run("window.dispatchEvent(new Event('blur'))")
        page.until(lambda: operator.states["right"] != "engaged")
        page.go_on(0.5)
        start = place(view)
        for _ in range(5):  # the key is still down, and repeats
            chromium.call("Input.dispatchKeyEvent", type="keyDown", key="a", code="KeyA", autoRepeat=True)
            page.go_on(0.1)
        assert operator.states["right"] != "engaged"
        assert np.linalg.norm(place(view) - start) < 1e-3
        page.key("keyUp", "a")
        page.lead("d")
        page.key("keyUp", "d")
        chromium.run("document.body.innerHTML = '<input id=words>'; document.getElementById('words').focus()")
        page.go_on(0.5)
        start = place(view)
        page.key("keyDown", "d")  # it is typed
        page.go_on(0.5)
        assert np.linalg.norm(place(view) - start) < 1e-3
        page.key("keyUp", "d")
        chromium.run("document.activeElement.blur()")
        page.lead("d")
        chromium.call("Page.setWebLifecycleState", state="frozen")  # as browsers do with pages that nobody sees
        page.until(lambda: operator.states["right"] != "engaged")
        assert way_after_braking(view) < 1e-3
        assert view.leader is None
        chromium.call("Page.setWebLifecycleState", state="active")
        assert not chromium.errors
