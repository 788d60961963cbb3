"""The page in Chromium: the scene, codes for other machines, TLS, and takes."""

from __future__ import annotations

import ssl
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, Protocol

import av
import numpy as np
import pytest
from rcs_data import Dataset

from rcs.envs.setup import Setup
from rcs.rollout.interactive.browser_view import BrowserView
from rcs.rollout.interactive.session import Session, playable
from tests.rollout.interactive.driven_page import server_of, words


@pytest.fixture
def view() -> Iterator[BrowserView]:
    """A page of an environment that does not wait for the wall clock."""
    session = Session(replace(playable(Setup(task="PickCuboid", reward="sparse")), stepping="async"))
    with BrowserView(session, port=0) as view:
        yield view
    view.session.close()


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


@pytest.mark.extras
def test_another_machine_needs_the_code(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    session = Session(replace(playable(Setup(task="Free")), stepping="async"))
    with session, BrowserView(session, host="0.0.0.0", port=0) as view:
        assert view.url.startswith("https://")
        assert server_of(view)._websock_server._host == "127.0.0.1"
        address, _, code = view.url.partition("?code=")
        assert len(code) == 8
        trusting = ssl.create_default_context(cafile=str(tmp_path / "rcs" / "teleop.pem"))
        with pytest.raises(urllib.error.HTTPError, match="401"):
            urllib.request.urlopen(address, timeout=20, context=trusting)
        keeps = urllib.request.build_opener(
            urllib.request.HTTPCookieProcessor(), urllib.request.HTTPSHandler(context=trusting)
        )
        with keeps.open(view.url, timeout=20) as page:
            assert b"<html" in page.read()


@pytest.mark.slow
@pytest.mark.extras
@pytest.mark.browser
def test_a_browser_elsewhere_leads_over_tls(chromium: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    monkeypatch.setattr("rcs.rollout.interactive.page_link.VALID_FOR", 60.0)  # it draws without a GPU
    session = Session(replace(playable(Setup(task="Free")), stepping="async"))
    with session, BrowserView(session, host="0.0.0.0", port=0) as view:
        chromium.call("Security.setIgnoreCertificateErrors", ignore=True)
        chromium.resize(640, 400)
        chromium.call("Page.navigate", url=view.url)
        end = time.monotonic() + 120
        while not chromium.run(f"{CLICK}('Next seed')") or session.seed == 0:
            assert time.monotonic() < end, chromium.run("document.body.innerText")
            view.update()
        assert chromium.run("location.protocol + location.search") == "https:"
        chromium.call("Page.navigate", url="about:blank")
        while view.leader is not None:
            assert time.monotonic() < end
            view.update()


CLICK = """((label) => [...document.querySelectorAll('button')].filter((one) => one.innerText.trim() == label)
    .map((one) => one.click()).length)"""


@pytest.mark.slow
@pytest.mark.browser
def test_takes_are_made_on_a_page_and_a_second_one_only_shows(
    chromium: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rcs.rollout.interactive.page_link.VALID_FOR", 60.0)  # it draws without a GPU
    setup = replace(playable(Setup(task="PickCuboid")), stepping="async")
    with Session(setup, record_into=tmp_path / "set") as session, BrowserView(session, port=0) as view:
        server = server_of(view)
        chromium.errors.clear()
        chromium.resize(640, 700)
        chromium.open(view.url)

        def until(is_true: Callable[[], bool]) -> None:
            end = time.monotonic() + 120
            while not is_true():
                assert time.monotonic() < end, f"errors: {chromium.errors}, {words(view)}"
                view.update()

        def click(label: str) -> bool:
            return chromium.run(f"{CLICK}({label!r})") == 1

        def key(letter: str) -> None:
            for kind in ("keyDown", "keyUp"):
                chromium.call("Input.dispatchKeyEvent", type=kind, key=letter, code=f"Key{letter.upper()}")

        until(lambda: "Discard" in chromium.run("document.body.innerText"))
        for begin, verdict in (("Start", "Success"), ("t", "Discard"), ("Start", "n")):
            for press in (begin, verdict):
                takes = session.takes
                before = None if takes is None else takes.now
                key(press) if len(press) == 1 else until(lambda press=press: click(press))
                until(lambda before=before: session.takes is not None and session.takes.now != before)
                until(lambda: session.takes is not None and (session.takes.now is None or session.takes.is_recording))
        assert session.takes is not None
        assert [(one.success, one.is_kept) for one in session.takes.ended] == [
            (True, True),
            (None, False),
            (False, True),
        ]
        first = chromium._session
        (leader,) = server.get_clients()
        assert view.leader == leader
        target = chromium.call("Target.createTarget", url=view.url, newWindow=True)["targetId"]
        until(lambda: len(server.get_clients()) == 2)
        chromium._session = chromium.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        until(lambda: "Discard" in chromium.run("document.body.innerText"))
        until(lambda: click("Next seed"))
        until(lambda: "Another page leads" in words(view))
        assert view.leader == leader
        chromium._session = first
        chromium.call("Page.navigate", url="about:blank")
        until(lambda: view.leader is None)
        assert all(guide.is_braking for guide in session.guides.values())
        assert not chromium.errors
    assert [one.success for one in Dataset.open(tmp_path / "set").episodes] == [True, False]
