"""A person who judges episodes, line by line: at a terminal, or on a page whose buttons make the same lines."""

from __future__ import annotations

import contextlib
import sys
import termios
from collections.abc import Callable, Mapping
from typing import Any

from rcs.envs.env import Env
from rcs.envs.spaces import Observation
from rcs.errors import Refused
from rcs.rollout.episode import Answer
from rcs.rollout.outlines import Outlines

VERDICTS: Mapping[str, bool | None] = {"y": True, "yes": True, "n": False, "no": False, "?": None}
"""Words with which an answer begins."""
UNDO = "u"
"""The line that takes the last answer back."""
_TRIES = 10
"""Number of lines that are no text after which nobody is asked any more."""

Asker = Callable[[str, Observation, int | None], str]
"""Asks a question, and returns a line. Also given are the last observation, and the seed of the episode whose objects
are to be put in place meanwhile; None if there is none."""


def read_line(question: str) -> str:
    """Return a line that the person at the terminal answers; what was typed before the question is no answer to it.

    Raises:
        Refused: The input has ended.
    """
    with contextlib.suppress(OSError, termios.error):  # no terminal, such as a pipe
        termios.tcflush(sys.stdin, termios.TCIFLUSH)
    try:
        return input(question)
    except EOFError as err:
        raise Refused("The input has ended; run the command at a terminal.") from err


def agrees(question: str) -> bool:
    """Return whether the person at the terminal answers a question with yes; raises as `read_line`."""
    return read_line(f"{question} [y]es, [n]o: ").strip().lower() in ("y", "yes")


def ask_at_terminal(question: str, observation: Observation, seed: int | None) -> str:
    """Ask the person at the terminal, again after bytes that are no text there: they could not be stored.

    Raises:
        Refused: The input has ended, or is no text.
    """
    notice = ""
    for _ in range(_TRIES):  # a pipe that ends within a character fails the same way for ever
        with contextlib.suppress(UnicodeError):
            line = read_line(f"{notice}{question}: ")
            line.encode()
            return line
        notice = "That was no text. "
    raise Refused("The input is no text; run the command at a terminal.")


def answer_in(line: str) -> Answer | None:
    """Return the answer in a line such as `n 2 #slipped out of the left finger`; None if there is none.

    Args:
        line: The verdict, the number of stages that were reached, tags after `#`, and words; all but the first may be
            left out.
    """
    first, *rest = line.split() or [""]
    if first.lower() not in VERDICTS:
        return None
    stages = int(rest.pop(0)) if rest and rest[0].isdecimal() else None
    return Answer(
        success=VERDICTS[first.lower()],
        stages=stages,
        tags=tuple(word[1:] for word in rest if word.startswith("#") and len(word) > 1),
        words=" ".join(word for word in rest if not word.startswith("#")) or None,
    )


class PersonJudge:
    """A judge whom a person answers. The next episode begins with the answer, so its objects are prepared before.

    The first one, and one before which nobody was asked, as after a fault, begins when the person says so.
    """

    def __init__(self, ask: Asker = ask_at_terminal, *, outlines: Outlines | None = None, can_undo: bool = True):
        """Prepare; nothing is asked yet.

        Args:
            ask: Asks.
            outlines: Knows where objects go; None where nobody has to put them there.
            can_undo: Whether an answer can be taken back.
        """
        self._ask, self._outlines, self._can_undo = ask, outlines, can_undo
        self._correct: Callable[[Answer], None] | None = None
        self._coming: int | None = None
        self._prepared: int | None = None
        """Seed of the episode that an answer has begun; None if nobody has answered since the last one began."""
        self._seen: Observation = {}
        self._is_answered = False
        """Whether the present episode has an answer: nobody is asked about one that a fault ended."""

    def announce(self, env: Env | None, seed: int, coming: int | None) -> None:
        """Get ready for an episode; one that no answer has begun waits until its objects are in their places.

        With real devices it waits where there are no objects, too, because it moves them. Only an empty line begins it:
        whoever judges the episode before, which nobody is asked about after a fault, may have the hands at the robot.

        Args:
            env: The environment, whose pictures show where the objects go; None to wait for nobody.
            seed: Seed of the episode.
            coming: Seed of the one after it, whose objects are to be prepared while it is judged; None after the last.

        Raises:
            Refused: The input has ended.
            DeviceFault: A device is in its fault state.
        """
        if env is not None and seed != self._prepared:
            places, is_real = self._places(seed), set(env.platform.values()) != {"simulation"}
            if places or is_real:
                observation, _ = env.reset(seed=seed)  # connects devices; nothing moves
                wanted = f"Put {places}. Then press" if places else "The next episode begins when you press"
                notice = ""
                while line := self._ask(f"{notice}{wanted} Enter, or Go on", observation, seed).strip():
                    notice = f"{line!r} begins nothing, and there is no episode to judge. "
        self._prepared, self._coming = None, coming

    def __call__(self, observation: Observation, info: Mapping[str, Any]) -> Answer:
        """Ask how an episode went, after the answer before, where that is taken back.

        Raises:
            Refused: The input has ended.
        """
        notice, self._seen = "", observation
        while True:
            undo = ", [u]ndo the last answer" if self._correct is not None else ""
            question = f"{notice}Was the task done? [y]es, [n]o, [?] not known{undo}; stages, #tags, words may follow"
            if places := self._places(self._coming):
                question = f"The next episode begins with your answer; put {places}. {question}"
            line = self._ask(question, observation, self._coming)
            if line.strip().lower() == UNDO and self._correct is not None:
                self._take_back()
                notice = "Now the present one. "
            elif (answer := answer_in(line)) is not None:
                self._is_answered, self._prepared = True, self._coming
                return answer
            else:
                notice = f"{line.strip()!r} is no answer. " if line.strip() else ""

    def answered(self, correct: Callable[[Answer], None]) -> None:
        """Note that an episode is in the ledger, with its answer if somebody was asked.

        Args:
            correct: Replaces the answer there by another one.
        """
        if self._is_answered:
            self._correct = correct if self._can_undo else None
        self._is_answered = False

    def end(self) -> None:
        """Offer to take the last answer back, once there is no further episode."""
        while self._correct is not None:
            line = self._ask("That was the last. [Enter] (or Go on) ends, [u]ndo the last answer", self._seen, None)
            if line.strip().lower() != UNDO:
                return
            self._take_back()

    def _take_back(self) -> None:
        assert self._correct is not None, "it is there"
        notice = "The last answer is taken back. "
        while True:
            line = self._ask(f"{notice}Was the task done in that one? [y]es, [n]o, [?] not known", self._seen, None)
            if (answer := answer_in(line)) is not None:
                self._correct(answer)
                return
            notice = f"{line.strip()!r} is no answer. "

    def _places(self, seed: int | None) -> str:
        return "" if self._outlines is None or seed is None else self._outlines.words(seed)
