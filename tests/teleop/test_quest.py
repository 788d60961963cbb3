"""The page for headsets: over TLS, as a program and as a browser see it."""

from __future__ import annotations

import contextlib
import json
import queue
import socket
import ssl
import stat
import time
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from rcs.errors import InvalidSetup
from rcs.teleop import credentials
from rcs.teleop.device import HandReading, Reading
from rcs.teleop.quest import Feedback, Quest, address_of

# They need websockets and cryptography, which `make test-extras` installs.
pytestmark = pytest.mark.extras
client = pytest.importorskip("websockets.sync.client", reason="pip install 'robot-control-stack[teleop]'")
pytest.importorskip("cryptography", reason="pip install 'robot-control-stack[teleop]'")
closed = pytest.importorskip("websockets.exceptions").ConnectionClosed

IWER = Path(__file__).parents[2] / "build" / "npm" / "package" / "build" / "iwer.min.js"
"""A WebXR runtime for tests, by Meta; `make test-extras` fetches it."""


@pytest.fixture
def quest() -> Iterator[Quest]:
    with Quest("127.0.0.1:0") as device:
        device.open()
        yield device


def port_of(quest: Quest) -> int:
    return int(quest.url.split(":")[2].split("/")[0])


def trusting() -> ssl.SSLContext:
    """Trust this machine's certificate, and no other."""
    return ssl.create_default_context(cafile=credentials.folder() / "teleop.pem")


@contextlib.contextmanager
def stream(quest: Quest, code: str | None = None) -> Iterator[Any]:
    with client.connect(f"wss://127.0.0.1:{port_of(quest)}/stream", ssl=trusting(), compression=None) as page:
        page.send(credentials.code() if code is None else code)
        yield page


def frame(number: int, at: float, *, x: float = 0.0, buttons: int = 0, **changes: Any) -> str:
    hand = {"pose": [x, 0, 0, 0, 0, 0, 1], "trigger": 0, "buttons": buttons, "stick": 0, **changes}
    return json.dumps({"number": number, "time": 1e3 * at, "round_trip": 0, "hands": {"right": hand}})


def next_of(quest: Quest, seconds: float = 5.0) -> Reading:
    end = time.monotonic() + seconds
    while (reading := quest.read()) is None:
        assert time.monotonic() < end
    return reading


def right(quest: Quest) -> HandReading:
    return next_of(quest).hands["right"]


def test_frames_become_readings_with_their_time(quest: Quest) -> None:
    with stream(quest) as page:
        assert json.loads(page.recv(5)) == {"accepted": True}
        sent = time.monotonic()
        page.send(frame(0, sent, x=0.5, buttons=2))
        reading = next_of(quest)
        assert reading.hands["right"].pose == pytest.approx([0, -0.5, 0, 0, 0, 0, 1])
        assert reading.hands["right"].buttons == {"clutch"}
        assert not reading.hands["left"].is_tracked
        assert sent <= reading.time <= time.monotonic()
        assert json.loads(page.recv(5)) == {"echo": 0}


def test_frames_that_were_held_up_have_their_true_age(quest: Quest) -> None:
    with stream(quest) as page:
        for number in range(5):
            page.send(frame(number, 0.02 * number))
            time.sleep(0.02)
        time.sleep(0.5)  # the network stalls, and then all come at once
        for number in range(5, 10):
            page.send(frame(number, 0.02 * number))
        readings = [next_of(quest) for _ in range(10)]
        assert np.diff([reading.time for reading in readings]) == pytest.approx(0.02, abs=0.015)
        assert time.monotonic() - readings[-1].time > 0.4


def test_pictures_that_nobody_takes_keep_no_frame_back(quest: Quest) -> None:
    noise = np.random.default_rng(0).integers(0, 255, (240, 320, 3), np.uint8)  # the kernel has room for one
    large = {"frames": {f"camera{at}": {"rgb": noise} for at in range(8)}}
    with stream(quest) as page:
        page.send(frame(0, 0.0))
        next_of(quest)
        end = time.monotonic() + 4.0
        while time.monotonic() < end:  # the page takes nothing any more once its queue is full
            quest.feedback(large, {})
            time.sleep(0.05)
        page.send(frame(1, 4.0))
        next_of(quest)


def test_what_makes_no_sense_is_left_out_and_counted(quest: Quest) -> None:
    with stream(quest) as page:
        page.send(frame(5, 1.0))
        next_of(quest)
        for rubbish in ("", "{}", "nonsense", b"\xff" * 100, frame(6, float("nan")), frame(5, 1.1), frame(6, 0.9)):
            page.send(rubbish)
        page.send(frame(7, 1.2, x=0.1))
        reading = next_of(quest)
        assert reading.hands["right"].pose == pytest.approx([0, -0.1, 0, 0, 0, 0, 1])
        assert reading.counts == {"damaged": 5, "disordered": 2}


def test_a_page_that_is_closed_while_pictures_are_offered_is_no_error() -> None:
    class Closed(Quest):
        """Is closed by another thread after each look at what shows pictures."""

        @property
        def _shown(self) -> Any:
            shown, self._last = self._last, None
            return shown

        @_shown.setter
        def _shown(self, shown: Any) -> None:
            self._last = shown

    quest, offered = Closed("127.0.0.1:0"), list[Any]()
    quest._shown = SimpleNamespace(offer=lambda *given: offered.append(given))
    quest.feedback({}, {})
    quest.feedback({}, {})
    assert offered == [({}, {})]


def test_a_wrong_code_is_refused_in_words_and_leads_nothing(quest: Quest) -> None:
    begin = time.monotonic()
    with stream(quest, "abcdefgh") as page:
        said = json.loads(page.recv(5))
        assert said["is_wrong_code"] and "code" in said["refused"]
        with pytest.raises(closed):
            page.recv(5)
    assert time.monotonic() - begin > 0.9  # guessing takes a while
    assert quest.read() is None
    with stream(quest) as page:
        page.send(frame(0, 0.0))
        assert next_of(quest).counts["wrong code"] == 1


def test_a_second_headset_waits_until_the_first_is_silent(quest: Quest) -> None:
    with stream(quest) as first:
        first.send(frame(0, 0.0))
        next_of(quest)
        with stream(quest) as second:
            assert "Another headset" in json.loads(second.recv(5))["refused"]
        time.sleep(2.1)
        with stream(quest) as second:
            assert json.loads(second.recv(5)) == {"accepted": True}
            second.send(frame(0, 7.0, x=0.2))
            assert right(quest).pose[1] == pytest.approx(-0.2)


def test_plain_http_is_answered_in_words(quest: Quest) -> None:
    with socket.create_connection(("127.0.0.1", port_of(quest))) as plain:
        plain.sendall(b"GET / HTTP/1.1\r\nHost: robot\r\n\r\n")
        answer = b""
        while part := plain.recv(4096):
            answer += part
    assert answer.startswith(b"HTTP/1.1 400")
    assert b"https://" in answer
    with stream(quest) as page:
        assert json.loads(page.recv(5)) == {"accepted": True}


def test_connections_of_rubbish_end_nothing(quest: Quest) -> None:
    rng = np.random.default_rng(1)
    for number in range(40):
        with socket.create_connection(("127.0.0.1", port_of(quest))) as plain, contextlib.suppress(OSError):
            plain.sendall(b"\x16" * (number % 2) + rng.bytes(rng.integers(1, 200)))
    with stream(quest) as page:
        page.send(frame(0, 0.0))
        assert right(quest).is_tracked


def test_the_page_loads_from_nowhere_else(quest: Quest) -> None:
    for path, kind, wanted in (("/", "text/html", b"headset.js"), ("/headset.js", "text/javascript", b"WebSocket")):
        plain = socket.create_connection(("127.0.0.1", port_of(quest)))
        with trusting().wrap_socket(plain, server_hostname="127.0.0.1") as page:
            page.sendall(f"GET {path} HTTP/1.1\r\nHost: a\r\n\r\n".encode())
            answer = b""
            while part := page.recv(65536):
                answer += part
        assert b"200 OK" in answer
        assert kind.encode() in answer
        assert b"default-src 'none'" in answer
        assert wanted in answer
        assert answer.count(b"//") == answer.count(b"// ") + answer.count(b"wss://") + answer.count(b"https://")


def test_the_certificate_and_the_code_are_made_once_and_for_their_owner_alone(quest: Quest) -> None:
    files = [credentials.folder() / name for name in ("teleop.pem", "teleop-code")]
    before = [path.read_bytes() for path in files]
    assert all(stat.S_IMODE(path.stat().st_mode) == 0o600 for path in files)
    assert quest.url.endswith(f"/#{credentials.code()}")
    assert quest.url in quest.instructions
    quest.close()
    quest.open()
    assert [path.read_bytes() for path in files] == before
    files[0].write_text("no certificate")
    with pytest.raises(InvalidSetup, match="delete it"):
        credentials.tls()


def test_a_port_that_is_taken_is_refused(quest: Quest) -> None:
    with Quest(f"127.0.0.1:{port_of(quest)}") as second, pytest.raises(InvalidSetup, match="free port"):
        second.open()


def test_a_page_that_closes_or_is_closed_leaves_no_reading(quest: Quest) -> None:
    with stream(quest) as page:
        page.send(frame(0, 0.0))
        next_of(quest)
    assert quest.read() is None
    with stream(quest) as page:
        page.recv(5)
        quest.close()
        with pytest.raises(closed):
            page.recv(5)


def test_cameras_and_states_are_sent_and_a_slow_headset_delays_nobody(quest: Quest) -> None:
    picture = np.full((48, 64, 3), 200, np.uint8)
    observation = {"frames": {"wrist": {"rgb": picture}}}
    with stream(quest) as page:
        page.send(frame(0, 0.0))
        next_of(quest)
        quest.feedback(observation, {"operator": {"right": "engaged"}})
        said = [page.recv(5) for _ in range(4)]
        assert json.loads(next(one for one in said if "states" in one)) == {"states": {"right": "engaged"}}
        data = next(one for one in said if isinstance(one, bytes))
        assert data[: data[0] + 1] == b"\x05wrist"
        assert data[6:8] == b"\xff\xd8"
        begin = time.monotonic()
        large = {"frames": {"wrist": {"rgb": np.random.default_rng(0).integers(0, 255, (720, 1280, 3), np.uint8)}}}
        for _ in range(200):
            quest.feedback(large, {})  # nobody reads them
        assert time.monotonic() - begin < 1.0


def test_addresses() -> None:
    assert address_of(None, 1) == ("0.0.0.0", 1)
    assert address_of("10.0.0.2:80", 1) == ("10.0.0.2", 80)
    assert address_of("10.0.0.2", 1) == ("10.0.0.2", 1)
    assert address_of("80", 1) == ("0.0.0.0", 80)
    for wrong in ("a:b", "1:99999", "a:"):
        with pytest.raises(InvalidSetup, match="HOST:PORT"):
            address_of(wrong, 1)


EMULATOR = """
const xr = new IWER.XRDevice(IWER.metaQuest3);
xr.installRuntime({ forceInstall: true });
xr.stereoEnabled = true;
window.xr = xr;
// The emulator calls all positions estimates, which those of a headset are while it does not see a controller.
window.isSeen = (is) => {
  for (const { inputSource: { gripSpace } } of Object.values(xr.controllers))
    for (const key of Object.getOwnPropertySymbols(gripSpace)) gripSpace[key].emulated = !is;
};
isSeen(true);
"""
MIDDLE = "(b => [b.x + b.width / 2, b.y + b.height / 2])(document.getElementById('ar').getBoundingClientRect())"


@pytest.mark.browser
def test_a_headset_in_a_browser_leads_and_shows_cameras(quest: Quest, chromium: Any) -> None:
    if not IWER.exists():
        pytest.skip("There is no build/npm/package/build/iwer.min.js; `make test-extras` fetches it.")
    chromium.call("Security.enable")
    chromium.call("Security.setIgnoreCertificateErrors", ignore=True)
    chromium.call("Page.addScriptToEvaluateOnNewDocument", source=IWER.read_text() + EMULATOR)
    chromium.open(quest.url)
    chromium.wait("document.getElementById('state').textContent === 'Connected.'")
    chromium.wait("!document.getElementById('ar').disabled")
    chromium.click(*chromium.run(MIDDLE))
    first = next_of(quest, 20.0)
    chromium.run("""
      const right = xr.controllers.right, left = xr.controllers.left;
      right.position.set(0.1, 1.2, -0.3);
      right.quaternion.set(0, Math.SQRT1_2, 0, Math.SQRT1_2);
      right.updateButtonValue('trigger', 0.75);
      right.updateButtonValue('squeeze', 1);
      left.updateButtonValue('y-button', 1);
    """)

    def seen(is_so: Any) -> Reading:
        end = time.monotonic() + 10
        while not is_so(reading := next_of(quest)):
            assert time.monotonic() < end, reading
        return reading

    reading = seen(lambda one: "clutch" in one.hands["right"].buttons and "failure" in one.hands["left"].buttons)
    hand = reading.hands["right"]
    assert hand.opening == pytest.approx(0.25, abs=0.01)
    assert hand.pose[:3] == pytest.approx([0.3, -0.1, 1.2], abs=0.15)  # the grip is off the controller's origin
    start = hand.pose
    chromium.run("xr.controllers.right.position.set(0.1, 1.2, -0.5)")
    moved = seen(lambda one: abs(one.hands["right"].pose[0] - start[0] - 0.2) < 1e-3).hands["right"].pose
    assert moved[1:] == pytest.approx(start[1:], abs=1e-3)
    assert reading.time > first.time

    picture = np.full((48, 64, 3), 90, np.uint8)
    quest.feedback({"frames": {"wrist": {"rgb": picture}}}, {"operator": {"right": "engaged"}})
    chromium.wait("document.querySelector('#pictures canvas')?.width === 64")
    chromium.wait("document.getElementById('state').textContent.startsWith('right: engaged')")
    seen(lambda one: one.hands["right"].is_tracked)  # and the cameras' panels are drawn without an error

    chromium.run("isSeen(false)")
    seen(lambda one: not one.hands["right"].is_tracked)
    chromium.run("isSeen(true)")
    seen(lambda one: one.hands["right"].is_tracked)
    chromium.run("xr.controllers.right.connected = false")
    seen(lambda one: not one.hands["right"].is_tracked)
    chromium.run("xr.controllers.right.connected = true")
    seen(lambda one: one.hands["right"].is_tracked)
    chromium.run("xr.updateVisibilityState('hidden')")
    end = time.monotonic() + 10
    while (reading := quest.read()) is not None and any(hand.is_tracked for hand in reading.hands.values()):
        assert time.monotonic() < end
    assert chromium.errors == []


@pytest.mark.parametrize("text", ["", " \n", "abc"])
def test_a_code_that_is_no_code_keeps_everybody_out(text: str) -> None:
    credentials.folder().mkdir(parents=True)
    (credentials.folder() / "teleop-code").write_text(text)
    with pytest.raises(InvalidSetup, match="delete it, and another code is made"):
        credentials.code()


def test_frames_that_are_read_while_they_are_dropped_end_no_connection(quest: Quest) -> None:
    server: Any = quest._connection

    class Read(queue.Queue[Any]):
        """Is emptied by the reader once it was found full."""

        def full(self) -> bool:
            return True

    server.frames = Read(1)
    with stream(quest) as page:
        assert json.loads(page.recv(20)) == {"accepted": True}
        for number in range(3):
            page.send(frame(number, 0.1 * number))
            assert json.loads(page.recv(20)) == {"echo": number}
            server.frames.get(timeout=20)


def test_no_camera_is_left_out_where_one_picture_at_a_time_is_under_way() -> None:
    class Server:
        def __init__(self) -> None:
            self.is_keeping_up, self.shown = True, set[bytes]()

        def send(self, message: str | bytes) -> None:
            if isinstance(message, str):  # the next round: what was sent has arrived
                self.is_keeping_up = True
            else:
                self.is_keeping_up = False
                self.shown.add(message[1 : 1 + message[0]])

    server: Any = Server()
    feedback = Feedback(server)
    frames = {"frames": {name: {"rgb": np.zeros((8, 8, 3), np.uint8)} for name in ("a", "b", "c")}}
    end = time.monotonic() + 10.0
    while server.shown != {b"a", b"b", b"c"}:
        assert time.monotonic() < end
        feedback.offer(frames, {})
        time.sleep(0.02)
    feedback.close()
