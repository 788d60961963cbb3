"""A page in the browser on which a person judges episodes, beside the live pictures of the cameras."""

from __future__ import annotations

import queue
import time
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from rcs.envs.env import Env
from rcs.envs.ports.camera import CameraPort
from rcs.envs.spaces import FRAMES, RGB, Observation
from rcs.rollout.interactive.page import Page, as_line
from rcs.rollout.outlines import Outlines
from rcs.rollout.person import UNDO

if TYPE_CHECKING:
    import viser

PERIOD = 0.1
"""Time between two looks at cameras and answers [s]."""
BUTTONS: Mapping[str, tuple[str, Literal["Y", "N", "K", "U", "G"]]] = {
    "Done": ("y", "Y"), "Not done": ("n", "N"), "Not known": ("?", "K"), "Undo last": (UNDO, "U"), "Go on": ("", "G"),
}  # fmt: skip
"""Buttons, the words that they stand for, and keys that do the same."""
RUNNING = "An episode is running."


class JudgePage(Page):
    """Asks a person on a page, whose pictures have outlines where objects go; a context manager."""

    def __init__(self, env: Env, outlines: Outlines | None, *, host: str = "127.0.0.1", port: int = 8080) -> None:
        """Prepare to serve; nothing is open yet.

        Args:
            env: The environment, whose cameras are shown.
            outlines: Knows where objects go; None where nobody has to put them there.
            host: Address to listen at; the default is for this machine alone; others need the code of `url`.
            port: Port to listen at, or the next one that is free; 0 for any.
        """
        super().__init__(host, port)
        self._env, self._outlines = env, outlines
        self._lines: queue.SimpleQueue[str] = queue.SimpleQueue()
        self._text: Any = None
        self._details: Any = None
        self._pictures: dict[str, Any] = {}

    def ask(self, question: str, observation: Observation, seed: int | None) -> str:
        """Ask, show live pictures until there is an answer, and return it as a line; see `rcs.rollout.person`."""
        assert self._server is not None, "it is open"
        while not self._lines.empty():  # a second click on the answer before
            self._lines.get()
        self._text.content = f"**{as_line(question)}**"
        while self._lines.empty():
            for name, picture in self.pictures(observation, seed).items():
                if name in self._pictures:
                    self._pictures[name].image = picture
                else:
                    gui = self._server.gui
                    self._pictures[name] = gui.add_image(picture, label=name, format="jpeg", jpeg_quality=90)
            time.sleep(PERIOD)
        self._text.content, self._details.value = RUNNING, ""
        return self._lines.get()

    def pictures(self, observation: Observation, seed: int | None) -> dict[str, NDArray[np.uint8]]:
        """Return the present pictures of the cameras, real ones live, with outlines where a seed's objects go."""
        frames: dict[str, dict[str, Any]] = {name: dict(frame) for name, frame in observation.get(FRAMES, {}).items()}
        for port in self._env.stack.ports:
            if isinstance(port, CameraPort):
                for name, frame in port.observe()[FRAMES].items():
                    frames[name] = {**frames.get(name, {}), **frame}
        if seed is None or self._outlines is None:
            return {name: frame[RGB] for name, frame in frames.items() if RGB in frame}
        return self._outlines.drawn(seed, frames)

    def _build(self, server: viser.ViserServer) -> None:
        gui = server.gui
        gui.configure_theme(show_logo=False, show_share_button=False, control_width="large")
        gui.set_panel_label("Judge")
        self._text = gui.add_markdown(RUNNING)
        self._details = gui.add_text("Details", "", hint="Number of stages that were reached, #tags, words; or none")
        group = gui.add_button_group(
            "Answer", tuple(BUTTONS), hint=", ".join(f"{BUTTONS[one][1]}: {one}" for one in BUTTONS)
        )

        @group.on_click
        async def _(event: Any) -> None:
            self._answer(event.target.value)

        for label, meaning in BUTTONS.items():
            command = gui.add_command(label, hotkey=meaning[1])

            @command.on_trigger
            async def _(trigger: Any, label: str = label) -> None:
                self._answer(label)

    def _answer(self, label: str) -> None:
        word, _ = BUTTONS[label]
        self._lines.put(word if word in ("", UNDO) else f"{word} {self._details.value}".strip())
