"""A headless Chromium for tests of the page, driven over a pair of pipes: no package, no port, no network."""

from __future__ import annotations

import base64
import fcntl
import json
import os
import select
import shutil
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rcs.data import DatasetInfo, DatasetWriter, Feature
from rcs.data.flags import FrameFlag

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
_FLAGS = (
    "--headless=new", "--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-extensions", "--mute-audio",
    "--disable-background-networking", "--disable-dev-shm-usage", "--disable-component-update", "--hide-scrollbars",
    "--autoplay-policy=no-user-gesture-required", "--remote-debugging-pipe",
    # The tests look at the pixels of videos from the disk; the page itself does without this.
    "--allow-file-access-from-files",
)  # fmt: skip


def find() -> str | None:
    """Return the path of a Chromium, or None."""
    return next((path for name in NAMES if (path := shutil.which(name))), None)


# A loaded machine takes seconds to start a browser.
_PATIENCE = 60.0


class Chromium:
    """A browser with one page."""

    def __init__(self, profile: Path, *, size: tuple[int, int] = (1440, 900)) -> None:
        """Start it.

        Args:
            profile: An empty folder for what it stores.
            size: Of the window [px].
        """
        program = find()
        if program is None:
            raise FileNotFoundError("There is no Chromium.")
        theirs_in, self._out = os.pipe()
        self._in, theirs_out = os.pipe()
        # The browser reads from descriptor 3 and writes to 4; numbers above those are not in each other's way.
        ends = [fcntl.fcntl(end, fcntl.F_DUPFD_CLOEXEC, 10) for end in (theirs_in, theirs_out)]

        def connect() -> None:
            os.dup2(ends[0], 3)
            os.dup2(ends[1], 4)

        flags = [*_FLAGS, f"--user-data-dir={profile}", f"--window-size={size[0]},{size[1]}"]
        self._process = subprocess.Popen(
            [program, *flags, "about:blank"],
            close_fds=False,  # 3 and 4 are to stay; all others are marked to be closed anyway
            preexec_fn=connect,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
        for end in (theirs_in, theirs_out, *ends):
            os.close(end)
        self._rest = b""
        self._count = 0
        self._session: str | None = None
        self.errors: list[str] = []
        targets = self.call("Target.getTargets")["targetInfos"]
        page = next(target["targetId"] for target in targets if target["type"] == "page")
        self._session = self.call("Target.attachToTarget", targetId=page, flatten=True)["sessionId"]
        self.call("Runtime.enable")
        self.call("Page.enable")
        self.resize(*size)

    def call(self, method: str, **params: Any) -> dict[str, Any]:
        """Send a command of the DevTools protocol and return its result."""
        self._count += 1
        message = {"id": self._count, "method": method, "params": params}
        if self._session is not None:
            message["sessionId"] = self._session
        os.write(self._out, json.dumps(message).encode() + b"\0")
        while True:
            answer = self._read()
            if answer.get("method") == "Runtime.exceptionThrown":
                details = answer["params"]["exceptionDetails"]
                self.errors.append(details.get("exception", {}).get("description", details["text"]))
            if answer.get("id") == self._count:
                if "error" in answer:
                    raise RuntimeError(f"{method}: {answer['error']}")
                return answer["result"]

    def _read(self) -> dict[str, Any]:
        while b"\0" not in self._rest:
            if not select.select([self._in], [], [], _PATIENCE)[0]:
                raise TimeoutError(f"Chromium has not answered for {_PATIENCE} s.")
            data = os.read(self._in, 1 << 16)
            if not data:
                raise RuntimeError("Chromium has ended.")
            self._rest += data
        message, self._rest = self._rest.split(b"\0", 1)
        return json.loads(message)

    def open(self, address: str) -> None:
        """Load a page anew, also where only the part after the # differs."""
        self.call("Page.navigate", url="about:blank")
        self.call("Page.navigate", url=address)
        self.wait("document.readyState === 'complete' && location.href !== 'about:blank'")

    def run(self, script: str) -> Any:
        """Return the value of a JavaScript expression; promises are waited for."""
        result = self.call("Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True)
        if "exceptionDetails" in result:
            raise RuntimeError(f"{script}: {result['exceptionDetails']}")
        return result["result"].get("value")

    def wait(self, script: str, seconds: float = 15.0) -> None:
        """Wait until a JavaScript expression is true."""
        end = time.monotonic() + seconds
        while not self.run(script):
            if time.monotonic() > end:
                raise TimeoutError(f"{script} is not true after {seconds} s; errors: {self.errors}.")
            time.sleep(0.02)

    def press(self, key: str, *, shift: bool = False) -> None:
        """Press and release a key, such as "j", " " or "ArrowRight"."""
        text = {"text": key} if len(key) == 1 else {}
        modifiers = 8 if shift else 0
        self.call("Input.dispatchKeyEvent", type="keyDown", key=key, modifiers=modifiers, **text)
        self.call("Input.dispatchKeyEvent", type="keyUp", key=key, modifiers=modifiers)

    def click(self, x: float, y: float) -> None:
        """Click a place of the window [px]."""
        for kind in ("mousePressed", "mouseReleased"):
            self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", buttons=1, clickCount=1)

    def resize(self, width: int, height: int) -> None:
        """Give the page another size [px]."""
        self.call("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=False)

    def prefer(self, scheme: str) -> None:
        """Prefer "light" or "dark" pages."""
        self.call("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": scheme}])

    def screenshot(self, path: Path) -> None:
        """Save what is seen as PNG."""
        path.write_bytes(base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"]))

    def close(self) -> None:
        """End the browser; twice is harmless."""
        if self._process.poll() is None:
            self._session = None
            try:
                self.call("Browser.close")
                self._process.wait(5)
            except (RuntimeError, OSError, subprocess.TimeoutExpired):
                self._process.kill()
                self._process.wait()
            os.close(self._out)
            os.close(self._in)


@pytest.fixture(scope="module")
def chromium(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Chromium]:
    """A browser for the tests of one file; they are skipped where there is none."""
    if find() is None:
        pytest.skip(f"There is no Chromium on the path: none of {', '.join(NAMES)}.")
    browser = Chromium(tmp_path_factory.mktemp("profile"))
    yield browser
    browser.close()


LENGTHS = {"000000": 40, "000001": 25, "000002": 33}
SUCCESS = {"000000": True, "000001": False, "000002": None}


def grey(row: int) -> int:
    """Return the brightness of the colour images in a row, so that a picture says which row it is of."""
    return 30 + 5 * row


@pytest.fixture(scope="session")
def filmed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A dataset of three episodes with two cameras, one with depth and flags, and with two late steps."""
    path = tmp_path_factory.mktemp("data") / "filmed"
    features = (
        Feature(key="observation/joints", shape=(3,), dtype="float64", unit="rad"),
        Feature(key="action/joints", shape=(3,), dtype="float64", unit="rad"),
        Feature(key="reward", shape=(), dtype="float64"),
        Feature(key="time/monotonic", shape=(), dtype="float64", unit="s"),
        Feature(key="flags/frames/side", shape=(), dtype="uint8"),
        Feature(key="observation/frames/side/rgb", shape=(60, 81, 3), dtype="uint8", encoding="jpeg"),
        Feature(key="observation/frames/side/depth", shape=(30, 40), dtype="uint16", unit="mm", encoding="depth"),
        Feature(key="observation/frames/wrist/rgb", shape=(32, 48, 3), dtype="uint8", encoding="lossless"),
    )
    info = DatasetInfo(
        frequency=30.0, features=features, setup={"task": "Pick", "robot": "fr3"}, instruction="pick it up"
    )
    with DatasetWriter.open(path, info) as writer:
        for episode_id, length in LENGTHS.items():
            with writer.episode(episode_id, seed=int(episode_id) + 7) as episode:
                time_now = 100.0
                for row in range(length):
                    time_now += 0.1 if row in (10, 20) else 1 / 30
                    values: dict[str, Any] = {
                        "observation/joints": np.sin(row / 5 + np.arange(3)),
                        "time/monotonic": time_now,
                        "flags/frames/side": np.uint8(FrameFlag.STALE if 5 <= row <= 7 else 0),
                        "observation/frames/side/rgb": np.full((60, 81, 3), grey(row), np.uint8),
                        "observation/frames/side/depth": np.full((30, 40), 500 + 10 * row, np.uint16),
                        "observation/frames/wrist/rgb": np.full((32, 48, 3), grey(row), np.uint8),
                    }
                    if row:
                        values |= {"action/joints": np.full(3, row / 10), "reward": row / 2}
                    episode.add(values)
                success = SUCCESS[episode_id]
                episode.finish(success, {"failure": "slip" if success is False else None})
    return path
