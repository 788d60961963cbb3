"""Several robots that wait for a policy which can answer them at once."""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from vlagents import Chunk, Client, InvalidInput, Metadata, Observation, PartSpec, Policy, PolicyFailed, Server


class Batched(Policy):
    """Doubles a number, of as many robots at once as wait; a negative one is a mistake."""

    def __init__(self) -> None:
        self.sizes: list[int] = []
        self.is_begun, self.go_on = threading.Event(), threading.Event()

    def metadata(self) -> Metadata:
        return Metadata(name="batched", action=(PartSpec("x", 1),), rate=10.0)

    def infer(self, observation: Observation) -> Chunk:
        self.is_begun.set()
        assert self.go_on.wait(20.0)
        self.sizes.append(1)
        if observation.state["x"][0] < 0:
            raise ValueError("negative")
        return Chunk(2.0 * observation.state["x"][None], 0.1, observation.time)

    def infer_batch(self, observations: Sequence[Observation]) -> Sequence[Chunk]:
        numbers = np.array([observation.state["x"] for observation in observations])
        if (numbers < 0).any():
            raise ValueError("one is negative")
        self.sizes.append(len(observations))
        return [Chunk(2.0 * number[None], 0.1) for number in numbers]


class OneByOne(Batched):
    """Has no batches of its own."""

    infer_batch = Policy.infer_batch


def ask_together(policy: Batched, numbers: Sequence[float], timeout: float = 20.0) -> list[Any]:
    """Have robots ask while the first is answered; return what each gets, an error in the place of actions."""
    found: list[Any] = [None] * len(numbers)
    with Server(policy, port=0) as server:
        clients = [Client(str(server.address), timeout=20.0 if i == 0 else timeout) for i in range(len(numbers))]

        def ask(i: int) -> None:
            try:
                found[i] = clients[i].infer(Observation(state={"x": np.array([numbers[i]])}, time=float(i)))
            except Exception as error:  # noqa: BLE001  the test looks at it
                found[i] = error

        threads = [threading.Thread(target=ask, args=(i,)) for i in range(len(numbers))]
        threads[0].start()
        assert policy.is_begun.wait(10.0)
        for thread in threads[1:]:
            thread.start()
        deadline = time.monotonic() + 10.0
        while len(server.service._waiting) < len(numbers) - 1 and time.monotonic() < deadline:
            time.sleep(0.005)
        if timeout < 1.0:
            time.sleep(2 * timeout)
        policy.go_on.set()
        for thread in threads:
            thread.join(20.0)
        assert not server.service._waiting
        for client in clients:
            client.close()
    return found


@pytest.mark.parametrize(("kind", "sizes"), [(Batched, [1, 5]), (OneByOne, [1] * 6)])
def test_those_who_wait_are_answered_at_once_and_each_with_its_own(kind: type[Batched], sizes: list[int]) -> None:
    policy = kind()
    found = ask_together(policy, range(6))
    assert [chunk.actions.tolist() for chunk in found] == [[[2.0 * i]] for i in range(6)]
    assert [chunk.time for chunk in found] == list(range(6))
    assert all(chunk.info["wait_ms"] >= 0 and chunk.info["infer_ms"] > 0 for chunk in found)
    assert policy.sizes == sizes


def test_a_mistake_of_one_robot_is_none_of_the_others() -> None:
    found = ask_together(Batched(), [0.0, 1.0, -1.0, 3.0])
    assert isinstance(found[2], PolicyFailed)
    assert [found[i].actions[0, 0] for i in (0, 1, 3)] == [0.0, 2.0, 6.0]


def test_whoever_waited_too_long_is_not_asked_for() -> None:
    policy = Batched()
    found = ask_together(policy, [0.0, 1.0, 2.0], timeout=0.3)
    assert all(isinstance(error, (TimeoutError, InvalidInput)) for error in found[1:])
    assert policy.sizes == [1]
