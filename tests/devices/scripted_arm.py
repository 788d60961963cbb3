"""An arm written in Python that does what a test tells it to."""

from __future__ import annotations

from typing import Any

from rcs.devices import (
    Arm,
    ArmLimits,
    ArmState,
)


class Scripted(Arm):
    """An arm that answers what it is told to, and notes what is asked of it."""

    def __init__(self, limits: ArmLimits, **answers: Any) -> None:
        super().__init__("scripted", limits)
        self.answers, self.calls = answers, []

    def _answer(self, call: str, usual: Any = None) -> Any:
        self.calls.append(call)
        answer = self.answers.get(call, usual)
        if isinstance(answer, BaseException):
            raise answer
        return answer

    def _open(self) -> None:
        self._answer("open")

    def _state(self) -> ArmState:
        return self._answer("state", ArmState([0.0, 0.0, 0.0], [0.0, 0.0, 0.0], 1.0))

    def _command_joints(self, joints: Any) -> None:
        self._answer("command_joints")

    def _has_arrived(self) -> bool:
        return self._answer("has_arrived", True)

    def _hold(self) -> None:
        self._answer("hold")

    def _recover(self) -> None:
        self._answer("recover")

    def _close(self) -> None:
        self._answer("close")
