"""A page on which a person judges two policies blindly: buttons, keys, live pictures with outlines."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from rcs_data.ledger import Ledger

import rcs
from rcs.agents import Agent
from rcs.rollout import Evaluation, Outlines, PersonJudge, Summary
from rcs.rollout.blind import evaluate_blind
from rcs.rollout.interactive.judge_page import RUNNING, JudgePage
from rcs.rollout.outlines import COLOUR

DETAILS = "[...document.querySelectorAll('input')].find((one) => one.className.includes('TextInput'))"
CLICK = """((label) => [...document.querySelectorAll('button')].filter((one) => one.innerText.trim() == label)
    .map((one) => one.click()).length)"""


class Alphabet(Agent):
    """Keeps every joint where it is."""

    def __init__(self, env: Any) -> None:
        self._space = env.action_space

    def reset(self, observation: Any, info: Any) -> None:
        """Nothing to forget."""

    def act(self, observation: Any, info: Any) -> Any:
        return {name: 0 * value + (name == "gripper") for name, value in self._space.sample().items()}


class Betamax(Alphabet):
    """Does the same under another name."""


@pytest.mark.slow
@pytest.mark.browser
@pytest.mark.gl
def test_two_policies_are_judged_blindly_on_a_page(chromium: Any, tmp_path: Path) -> None:
    cameras = rcs.Cameras(names=("side",), image_size=(320, 240))
    setup = rcs.Setup("PickCuboid", cameras=cameras, max_episode_steps=2)
    one, other = (
        Evaluation(setup=setup, agent=agent, episodes=2, out=tmp_path / "out") for agent in (Alphabet, Betamax)
    )
    seen = list[str]()
    with (
        rcs.make(setup, hardware="sim") as env,
        Outlines(setup) as outlines,
        JudgePage(env, outlines, port=0) as page,
    ):
        judge, errors = PersonJudge(page.ask, outlines=outlines), list[BaseException]()

        def evaluate() -> None:
            try:
                for _ in evaluate_blind((one, other), Summary(), env, judge=judge):
                    pass
                judge.end()
            except BaseException as err:  # noqa: BLE001  told by the main thread
                errors.append(err)

        thread = threading.Thread(target=evaluate, name="evaluation", daemon=True)
        thread.start()
        chromium.errors.clear()
        chromium.resize(900, 700)
        chromium.open(page.url)

        def until(words: str) -> None:
            end = time.monotonic() + 120
            while words not in (shown := chromium.run("document.body.innerText")):
                assert time.monotonic() < end, (words, shown, errors, chromium.errors)
                time.sleep(0.1)
            seen.append(shown)

        def wait(is_true: Callable[[], bool]) -> None:
            end = time.monotonic() + 120
            while not is_true():
                assert time.monotonic() < end, (errors, chromium.errors)
                time.sleep(0.05)

        def click(label: str) -> None:
            assert chromium.run(f"{CLICK}({label!r})") == 1, label

        def key(letter: str) -> None:
            for kind in ("keyDown", "keyUp"):
                chromium.call("Input.dispatchKeyEvent", type=kind, key=letter, code=f"Key{letter.upper()}")

        until("Put the cuboid at x")
        time.sleep(1.0)  # pictures come ten times per second
        chromium.screenshot(tmp_path / "page.png")
        click("Go on")
        until("Was the task done?")
        chromium.run(f"{DETAILS}.focus()")
        chromium.call("Input.insertText", text="2 #slip to the left")
        time.sleep(0.5)
        click("Not done")
        until("[u]ndo the last answer")
        chromium.run("document.activeElement.blur()")
        key("u")
        until("The last answer is taken back")
        key("k")
        until("Now the present one")
        click("Done")
        for rows in (2, 3):
            wait(lambda rows=rows: len(Ledger(tmp_path / "out").rows) == rows)
            wait(lambda: "Was the task done?" in page._text.content)  # a key before that is one of the answer before
            key("y")
        until("That was the last")
        click("Go on")
        thread.join(60)
        assert errors == []
        until(RUNNING)
        assert not chromium.errors
        observation, _ = env.reset(seed=0)
        picture = page.pictures(observation, 0)["side"]
        assert (picture == COLOUR).all(-1).sum() > 50
        assert np.array_equal(page.pictures(observation, None)["side"], observation["frames"]["side"]["rgb"])
    rows = list(Ledger(tmp_path / "out").rows.values())
    assert [(row.success, row.corrections) for row in rows] == [(None, 1), (True, 0), (True, 0), (True, 0)]
    for secret in ("Alphabet", "Betamax"):
        assert secret not in "".join(seen)
        assert all(secret not in path.read_text() for path in (tmp_path / "out").rglob("*.json*"))


def test_a_question_is_shown_and_not_rendered() -> None:
    shown = list[str]()

    class Text:
        """Has the answer as soon as the question is shown."""

        def __setattr__(self, name: str, value: str) -> None:
            shown.append(value)
            page._answer("Done")

    env: Any = SimpleNamespace(stack=SimpleNamespace(ports=[]))
    page: Any = JudgePage(env, None)
    page._server, page._text, page._details = object(), Text(), SimpleNamespace(value="")
    assert page.ask("'<img src=x onerror=alert(1)>' is no answer. [y]es", {}, None) == "y"
    assert shown[0].startswith("**'&lt;img src=x onerror=alert")
    assert "<" not in shown[0]
    assert shown[0].endswith(r"\[y\]es**")
