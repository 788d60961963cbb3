"""Errors of a policy: the caller gets them in words, and keeps its connection."""

from __future__ import annotations

from typing import Any

import pytest
from vlagents import BadMessage, Observation, PolicyFailed, Server, connect
from vlagents.errors import as_failure
from vlagents.policies.random import RandomPolicy
from vlagents.websocket import WebsocketServer


class Wrong(RandomPolicy):
    """Raises what it is given."""

    def __init__(self, error: Exception) -> None:
        super().__init__(size=1)
        self.error = error

    def infer(self, observation: Observation) -> Any:
        raise self.error


ERRORS = {
    "long": (ValueError("x" * 300_000), "ValueError: x{9000}"),
    "of another server": (BadMessage("ws://gpu:8000 failed"), "BadMessage: ws://gpu:8000 failed"),
}


@pytest.mark.parametrize("server_of", [Server, WebsocketServer])
@pytest.mark.parametrize("which", ERRORS)
def test_whatever_a_policy_raises_the_connection_stays(server_of: Any, which: str) -> None:
    error, words = ERRORS[which]
    with server_of(Wrong(error), port=0) as server, connect(str(server.address)) as client:
        for _ in range(2):
            with pytest.raises(PolicyFailed, match=words):
                client.infer(Observation())


def test_half_a_letter_is_replaced() -> None:
    assert as_failure(ValueError("\udcff")) == {"kind": PolicyFailed.kind, "text": "ValueError: ?"}
