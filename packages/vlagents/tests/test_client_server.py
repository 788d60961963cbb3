from __future__ import annotations

import io
import re
import socket
import threading
import time
import urllib.error
import urllib.request
from typing import Any

import numpy as np
import pytest
from vlagents import (
    AddressTaken,
    BadMessage,
    Chunk,
    Client,
    ConnectionLost,
    DeadlineExceeded,
    InvalidInput,
    Jpeg,
    Metadata,
    Mismatch,
    Observation,
    Offer,
    PartSpec,
    Policy,
    PolicyFailed,
    Server,
    Unauthorized,
)
from vlagents.policies.random import RandomPolicy
from vlagents.websocket import WebsocketClient, WebsocketServer

ACTION = (PartSpec("joints", 2),)


class Echo(Policy):
    """Answers with what it was shown, and remembers what its sessions were told."""

    def __init__(self) -> None:
        self.seen: list[Observation] = []
        self.told: dict[str, str] = {}
        self.forgotten: list[str] = []
        self.go_on = threading.Event()
        self.go_on.set()
        self.is_closed = False

    def metadata(self) -> Metadata:
        return Metadata(name="echo", action=ACTION, rate=10.0)

    def reset(self, session: str = "", instruction: str = "", *, seed: int | None = None) -> None:
        self.told[session] = instruction

    def infer(self, observation: Observation) -> Chunk:
        self.go_on.wait(20.0)
        self.seen.append(observation)
        if observation.instruction == "fail":
            raise ZeroDivisionError("on purpose")
        if observation.instruction == "wide":
            return Chunk(np.zeros((1, 3)), 0.1)
        told = self.told.get(observation.session, "")
        return Chunk(np.array([[float(len(told)), observation.state["joints"].sum()]]), 0.1)

    def forget(self, session: str) -> None:
        self.forgotten.append(session)

    def close(self) -> None:
        self.is_closed = True


class Pair:
    """A server of one kind and how to reach it."""

    def __init__(self, kind: str, policy: Policy, **options: Any) -> None:
        self.kind = kind
        self.server: Any = (WebsocketServer if kind == "websocket" else Server)(policy, port=0, **options)
        self.server.start()

    def __enter__(self) -> Pair:
        return self

    def __exit__(self, *_: object) -> None:
        self.server.close()

    def connect(self, **options: Any) -> Any:
        if self.kind == "websocket":
            return WebsocketClient(str(self.server.address), **options)
        return Client(str(self.server.address), is_shared=self.kind == "shared", **options)


@pytest.fixture(params=["shared", "tcp", "websocket"])
def kind(request: pytest.FixtureRequest) -> str:
    return request.param


@pytest.fixture
def echo() -> Echo:
    return Echo()


@pytest.fixture
def pair(kind: str, echo: Echo) -> Any:
    pair = Pair(kind, echo)
    yield pair
    echo.go_on.set()
    pair.server.close()


def test_a_policy_sees_what_was_observed(pair: Pair, echo: Echo, observation: Observation) -> None:
    with pair.connect() as client:
        if pair.kind == "shared":
            assert client.is_shared
        client.reset("left", "pick", seed=3)
        chunk = client.infer(observation)
        np.testing.assert_array_equal(chunk.actions, [[4.0, 21.0]])
        assert (chunk.time, chunk.period) == (observation.time, 0.1)
    (seen,) = echo.seen
    np.testing.assert_array_equal(seen.images["side"], observation.images["side"])
    np.testing.assert_array_equal(seen.state["joints"], observation.state["joints"])
    assert seen.instruction == observation.instruction
    assert seen.time == observation.time


def test_what_a_policy_is_shown_is_its_own_to_write_and_to_keep(pair: Pair, echo: Echo) -> None:
    with pair.connect() as client:
        for fill in range(5):
            image = np.full((240, 320, 3), fill, np.uint8)
            client.infer(Observation({"side": image, "small": image[:4]}, {"joints": np.full(3, float(fill))}))
            for array in (*echo.seen[fill].images.values(), *echo.seen[fill].state.values()):
                assert isinstance(array, np.ndarray)
                array.reshape(-1)[:2] = 99
    for fill, seen in enumerate(echo.seen):
        for array in (*seen.images.values(), *seen.state.values()):
            assert np.asarray(array).reshape(-1)[:3].tolist() == [99, 99, fill]
            assert (np.asarray(array).reshape(-1)[2:] == fill).all()


def test_pictures_may_stay_compressed(kind: str, echo: Echo) -> None:
    pillow = pytest.importorskip("PIL.Image")
    image = np.full((32, 48, 3), 90, np.uint8)
    file = io.BytesIO()
    pillow.fromarray(image).save(file, "JPEG")
    with Pair(kind, echo) as pair, pair.connect() as client:
        data = file.getvalue()
        client.infer(Observation(images={"side": Jpeg(data)}, state={"joints": np.zeros(2)}))
        np.testing.assert_allclose(echo.seen[0].image("side"), image, atol=3)


def test_two_robots_on_one_server_never_mix(pair: Pair, observation: Observation) -> None:
    with pair.connect() as one, pair.connect() as other:
        one.reset("left", "ab")
        other.reset("left", "abcdef")
        for _ in range(5):
            assert one.infer(observation).actions[0, 0] == 2
            assert other.infer(observation).actions[0, 0] == 6


def test_sessions_of_one_client_do_not_mix(pair: Pair) -> None:
    with pair.connect() as client:
        client.reset("left", "ab")
        client.reset("right", "abc")
        state = {"joints": np.zeros(1)}
        assert client.infer(Observation(state=state, session="left")).actions[0, 0] == 2
        assert client.infer(Observation(state=state, session="right")).actions[0, 0] == 3


def test_a_client_that_leaves_touches_nobody_else(pair: Pair, echo: Echo, observation: Observation) -> None:
    with pair.connect() as stays:
        stays.reset("left", "ab")
        with pair.connect() as leaves:
            leaves.reset("left", "abc")
        for _ in range(100):
            if echo.forgotten:
                break
            threading.Event().wait(0.02)
        assert len(echo.forgotten) == 1
        assert stays.infer(observation).actions[0, 0] == 2
        assert not echo.is_closed


def test_what_the_policy_raises_arrives_and_the_connection_stays(pair: Pair, observation: Observation) -> None:
    with pair.connect() as client:
        state = {"joints": np.zeros(1)}
        with pytest.raises(PolicyFailed, match="ZeroDivisionError: on purpose"):
            client.infer(Observation(state=state, instruction="fail"))
        with pytest.raises(InvalidInput, match="actions of 3 numbers"):
            client.infer(Observation(state=state, instruction="wide"))
        client.infer(observation)


@pytest.mark.parametrize(
    ("answer", "told"), [(np.zeros((1, 2)), "ndarray"), ({"actions": np.zeros((1, 2))}, "dict"), (None, "None")]
)
def test_what_is_no_chunk_is_named_to_the_client_and_in_the_log(
    kind: str, answer: Any, told: str, observation: Observation, caplog: pytest.LogCaptureFixture
) -> None:
    class Mistaken(Echo):
        def infer(self, observation: Observation) -> Any:
            return answer

    words = f"`infer` of the policy 'echo' returned {told}; valid is vlagents.Chunk(actions, period, time)."
    with Pair(kind, Mistaken()) as pair, pair.connect() as client:
        for _ in range(2):  # the connection stays
            with pytest.raises(InvalidInput) as caught:
                client.infer(observation)
            assert str(caught.value) == words
    assert words in caplog.text
    assert "Traceback" not in caplog.text


def test_a_robot_that_does_not_fit_is_told_why(pair: Pair) -> None:
    with pytest.raises(Mismatch, match="size 2"):
        pair.connect(offer=Offer(action=(PartSpec("joints", 7),)))


def test_a_late_answer_is_a_typed_error(kind: str, pair: Pair, echo: Echo, observation: Observation) -> None:
    with pair.connect(timeout=0.3) as client:
        client.reset("left", "ab")
        echo.go_on.clear()
        with pytest.raises(DeadlineExceeded, match=r"within 0\.3 s"):
            client.infer(observation)
        echo.go_on.set()
        if kind == "websocket":  # openpi's answers have no number: one that is late cannot be told from the next
            with pytest.raises(ConnectionLost):
                client.infer(observation)
            client.reset("left", "ab")
        assert client.infer(observation).actions[0, 0] == 2


def test_late_answers_do_not_pile_up(echo: Echo, observation: Observation) -> None:
    pair = Pair("shared", echo)
    with pair, pair.connect(timeout=0.1) as client:
        echo.go_on.clear()
        for _ in range(5):
            with pytest.raises(DeadlineExceeded):
                client.infer(observation)
        echo.go_on.set()
        client.timeout = 5.0
        client.infer(observation)
        assert len(echo.seen) == 3


def test_after_the_server_has_gone_only_a_reset_connects_anew(kind: str, echo: Echo, observation: Observation) -> None:
    pair = Pair(kind, echo)
    client = pair.connect(timeout=1.0)
    port = pair.server.address.port
    pair.server.close()
    for _ in range(2):
        with pytest.raises((ConnectionLost, BadMessage)):
            client.infer(observation)
    with pytest.raises(ConnectionLost):
        client.reset()
    again: Any = (WebsocketServer if kind == "websocket" else Server)(Echo(), port=port)
    with again:
        client.reset("left", "abc")
        assert client.infer(observation).actions[0, 0] == 3
    client.close()


def test_a_policy_that_came_in_its_place_must_fit_the_robot_too(
    kind: str, echo: Echo, observation: Observation
) -> None:
    class Wide(Echo):
        def metadata(self) -> Metadata:
            return Metadata(name="wide", action=(PartSpec("joints", 7),), rate=10.0)

    make: Any = WebsocketServer if kind == "websocket" else Server
    pair = Pair(kind, echo)
    client = pair.connect(timeout=1.0, offer=Offer(action=ACTION))
    port = pair.server.address.port
    pair.server.close()
    with pytest.raises((ConnectionLost, BadMessage)):
        client.infer(observation)
    with make(Wide(), port=port):
        for _ in range(2):
            with pytest.raises(Mismatch, match="size 7"):
                client.reset()
            with pytest.raises(ConnectionLost):
                client.infer(observation)
    with make(Echo(), port=port):
        client.reset("left", "abc")
        assert client.infer(observation).actions[0, 0] == 3
    client.close()


def test_without_the_token_nobody_gets_in(kind: str, observation: Observation) -> None:
    pair = Pair(kind, Echo(), token="correct horse")
    with pair:
        for wrong in (None, "", "correct horsf", "correct horses"):
            with pytest.raises(Unauthorized):
                pair.connect(token=wrong)
        with pair.connect(token="correct horse") as client:
            client.infer(observation)


@pytest.mark.parametrize("make", [Server, WebsocketServer])
def test_an_address_that_others_reach_needs_a_token(make: Any) -> None:
    for host in ("0.0.0.0", "::", "192.168.1.5", "example.org"):
        with pytest.raises(InvalidInput, match="token"):
            make(RandomPolicy(), host=host)


def test_a_client_needs_an_address_and_somebody_there() -> None:
    for wrong in ("", "localhost:80", "http://localhost:80", "vla://", "vla://h:99999", "vla://h/path"):
        with pytest.raises(InvalidInput, match=r"valid are vla://|port"):
            Client(wrong)
    with pytest.raises(ConnectionLost, match="No server is at"):
        Client("vla://127.0.0.1:1")


def test_a_websocket_server_tells_its_health_and_refuses_what_is_no_websocket() -> None:
    with WebsocketServer(RandomPolicy(), port=0, token="secret") as server:
        url = f"http://127.0.0.1:{server.address.port}"
        with urllib.request.urlopen(f"{url}/healthz", timeout=5.0) as answer:
            assert answer.read() == b"OK\n"
        with pytest.raises(urllib.error.HTTPError, match="401"):
            urllib.request.urlopen(url, timeout=5.0)
    with WebsocketServer(RandomPolicy(), port=0) as server, pytest.raises(urllib.error.HTTPError, match="426"):
        urllib.request.urlopen(f"http://127.0.0.1:{server.address.port}", timeout=5.0)


def test_closing_twice_does_no_harm(pair: Pair, echo: Echo) -> None:
    client = pair.connect()
    client.close()
    client.close()
    pair.server.close()
    pair.server.close()
    assert echo.is_closed


@pytest.mark.parametrize("make", [Server, WebsocketServer])
def test_a_server_serves_until_it_is_closed(make: Any) -> None:
    with make(RandomPolicy(), port=0) as server:
        serving = threading.Thread(target=server.serve_forever)
        serving.start()
        serving.join(0.1)
        assert serving.is_alive()
        server.close()
        serving.join(5.0)
        assert not serving.is_alive()


@pytest.mark.parametrize("host", ["127.0.0.1", "::1"])
@pytest.mark.parametrize("make", [Server, WebsocketServer])
def test_an_address_that_is_taken_is_named(make: Any, host: str) -> None:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        other = socket.create_server((host, 0), family=family)
    except OSError:
        pytest.skip(f"this machine has no {host}")
    with other:
        port = other.getsockname()[1]
        shown = f"[{host}]:{port}" if ":" in host else f"{host}:{port}"
        with pytest.raises(AddressTaken, match=f"{re.escape(shown)}.*--port") as caught:
            make(RandomPolicy(), host=host, port=port).start()
        assert isinstance(caught.value, OSError)


def test_vla_at_a_websocket_is_told_so_at_once() -> None:
    with WebsocketServer(RandomPolicy(), port=0) as server:
        begin = time.monotonic()
        with pytest.raises(BadMessage, match="ws://"):
            Client(f"vla://127.0.0.1:{server.address.port}", timeout=3.0)
        assert time.monotonic() - begin < 2.0
        with WebsocketClient(str(server.address)) as client:
            client.infer(Observation())


def test_vla_at_somebody_who_says_nothing_hints_at_websockets() -> None:
    with socket.create_server(("127.0.0.1", 0)) as silent:
        port = silent.getsockname()[1]
        with pytest.raises(DeadlineExceeded, match=rf"within 0\.3 s\..*ws://127\.0\.0\.1:{port}"):
            Client(f"vla://127.0.0.1:{port}", timeout=0.3)
