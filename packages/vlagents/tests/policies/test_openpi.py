"""Our openpi policy against a server that is written with openpi's messages, by msgpack and websockets alone."""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import msgpack
import numpy as np
import pytest
from vlagents import Client, ConnectionLost, InvalidInput, Observation, PartSpec, Server
from vlagents.errors import MissingStack
from vlagents.policies.openpi import DROID_STEP, OpenpiPolicy
from vlagents.policies.settings import Settings
from websockets.exceptions import ConnectionClosed
from websockets.sync.server import ServerConnection, serve


def _packed(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return {b"__ndarray__": True, b"data": value.tobytes(), b"dtype": value.dtype.str, b"shape": value.shape}
    raise TypeError(type(value))


def _unpacked(found: dict[Any, Any]) -> Any:
    if b"__ndarray__" in found:
        return np.ndarray(buffer=found[b"data"], dtype=np.dtype(found[b"dtype"]), shape=found[b"shape"])
    return found


@contextmanager
def stock_server(act: Callable[[dict[str, Any]], np.ndarray]) -> Iterator[tuple[str, list[dict[str, Any]]]]:
    """Answer as openpi's server does; yield its address, and the observations that came."""
    seen: list[dict[str, Any]] = []

    def converse(connection: ServerConnection) -> None:
        connection.send(msgpack.packb({"reset_pose": [0.0]}))
        try:
            for message in connection:
                observation = msgpack.unpackb(message, object_hook=_unpacked)
                seen.append(observation)
                try:
                    answer = {"actions": act(observation), "server_timing": {"infer_ms": 1.0}}
                except KeyError as error:
                    connection.send(f"Traceback: KeyError: {error}")
                    return
                connection.send(msgpack.packb(answer, default=_packed))
        except ConnectionClosed:
            return

    with serve(converse, "127.0.0.1", 0, compression=None, max_size=None) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        try:
            yield f"ws://127.0.0.1:{server.socket.getsockname()[1]}", seen
        finally:
            server.shutdown()
            thread.join(5.0)


def pi0_droid(observation: dict[str, Any]) -> np.ndarray:
    """Answer with a chunk that shows what came: velocities are the joints, the gripper is where it is."""
    assert observation["observation/exterior_image_1_left"].shape == (224, 224, 3)
    row = np.concatenate([observation["observation/joint_position"], observation["observation/gripper_position"]])
    return np.tile(row, (10, 1)).astype(np.float32)


def pi0_libero(observation: dict[str, Any]) -> np.ndarray:
    brightness = [observation[f"observation/{name}"].mean() for name in ("image", "wrist_image")]
    return np.tile([*brightness, *observation["observation/state"][3:8]], (50, 1))


def seen_by_droid(session: str = "", **more: Any) -> Observation:
    images = {"side": np.full((224, 224, 3), 9, np.uint8), "wrist": np.full((224, 224, 3), 3, np.uint8)}
    state = {"joints": np.linspace(-0.6, 2.0, 7), "gripper": np.ones(1)}
    return Observation(images=images, state=state, session=session, **more)


DROID_SETTINGS = Settings(
    images={"observation/exterior_image_1_left": "side", "observation/wrist_image_left": "wrist"},
    options={"layout": "droid"},
)


def test_pi0_droid_is_asked_with_its_keys_and_answers_in_the_robots_units() -> None:
    with stock_server(pi0_droid) as (address, asked), OpenpiPolicy(address, DROID_SETTINGS) as policy:
        metadata = policy.metadata()
        assert (metadata.horizon, metadata.rate, metadata.size) == (10, 15.0, 8)
        assert [(part.name, part.unit, part.meaning) for part in metadata.action] == [
            ("joints", "rad", "delta"),
            ("gripper", "0 closed, 1 open", "absolute"),
        ]
        policy.reset("robot", "pick up the green cuboid")
        observation = seen_by_droid("robot", time=2.0)
        chunk = policy.infer(observation)
        assert asked[-1]["prompt"] == "pick up the green cuboid"
        assert asked[-1]["observation/gripper_position"].tolist() == [0.0]  # DROID's open
        expected = DROID_STEP * np.clip(observation.state["joints"], -1.0, 1.0)
        assert np.allclose(chunk.actions[:, :7], expected)
        assert (chunk.actions[:, 7].tolist(), chunk.time) == ([1.0] * 10, 2.0)
        closed = Observation(**{**vars(observation), "state": {**observation.state, "gripper": np.zeros(1)}})
        assert policy.infer(closed).actions[0, 7] == 0.0


def test_pi0_libero_is_asked_with_its_keys() -> None:
    settings = Settings(
        images={"observation/image": "side", "observation/wrist_image": "wrist"},
        state=(PartSpec("xyz_rotation_vector", 6, "m, rad"), PartSpec("fingers", 2, "m")),
        action=(PartSpec("osc_pose", 6, "-1 to 1", "delta"), PartSpec("closing", 1, "-1 open, 1 closed")),
        rate=20.0,
    )
    with stock_server(pi0_libero) as (address, _), OpenpiPolicy(address, settings) as policy:
        images = {"side": np.full((224, 224, 3), 9, np.uint8), "wrist": np.full((224, 224, 3), 3, np.uint8)}
        state = {"xyz_rotation_vector": np.arange(6.0), "fingers": np.array([6.0, 7.0])}
        chunk = policy.infer(Observation(images=images, state=state, instruction="push"))
        assert chunk.actions.shape == (50, 7)
        assert chunk.actions[0].tolist() == [9.0, 3.0, 3.0, 4.0, 5.0, 6.0, 7.0]


def test_ones_own_data_have_ones_own_keys_and_units() -> None:
    settings = Settings.from_dict(
        {
            "images": {"observation/side": "side"},
            "state": [{"name": "joints", "size": 7, "unit": "rad"}, {"name": "gripper", "size": 1}],
            "action": [
                {"name": "joints", "size": 7, "unit": "rad", "meaning": "delta"},
                {"name": "gripper", "size": 1},
            ],
            "rate": 10,
        }
    )
    with (
        stock_server(lambda observation: np.tile(observation["observation/state"], (4, 1))) as (address, asked),
        OpenpiPolicy(address, settings) as policy,
    ):
        observation = seen_by_droid(instruction="push")
        assert np.allclose(policy.infer(observation).actions[0, :7], observation.state["joints"])
        assert set(asked[-1]) == {"observation/side", "observation/state", "prompt"}
        assert policy.metadata().rate == 10


def test_an_openpi_server_behind_our_wire_keeps_two_robots_apart() -> None:
    with (
        stock_server(pi0_droid) as (address, asked),
        Server(OpenpiPolicy(address, DROID_SETTINGS), port=0) as server,
        Client(str(server.address)) as policy,
    ):
        policy.reset("left", "pick up the green cuboid")
        policy.reset("right", "push the red cuboid")
        for session in ("left", "right", "left"):
            policy.infer(seen_by_droid(session))
        prompts = [each["prompt"] for each in asked[1:]]
        assert prompts == ["pick up the green cuboid", "push the red cuboid", "pick up the green cuboid"]


def test_what_does_not_fit_is_said_before_a_robot_waits() -> None:
    wrong = Settings(options={"layout": "droid"}, images={"observation/image": "side"})
    with stock_server(pi0_libero) as (address, _):
        with pytest.raises(InvalidInput, match="exterior_image_1_left"):
            OpenpiPolicy(address, wrong)
        with pytest.raises(InvalidInput, match="must have images, state, action and rate"):
            OpenpiPolicy(address, Settings())
        with pytest.raises(InvalidInput, match="droid, own"):
            OpenpiPolicy(address, Settings(options={"layout": "aloha"}))
        # The server wants LIBERO's keys: it says so and closes, as openpi's does.
        with pytest.raises(Exception, match="KeyError"):
            OpenpiPolicy(address, DROID_SETTINGS)
    with pytest.raises(ConnectionLost):
        OpenpiPolicy(address, DROID_SETTINGS)


def test_a_checkpoint_of_openpi_needs_its_stack_and_its_config() -> None:
    with pytest.raises(InvalidInput, match="'config' is missing"):
        OpenpiPolicy("checkpoints/pi0_droid", DROID_SETTINGS)
    options = {"layout": "droid", "config": "pi0_droid"}
    with pytest.raises(MissingStack, match="vlagents recipe openpi"):
        OpenpiPolicy("checkpoints/pi0_droid", Settings(images=DROID_SETTINGS.images, options=options))


def test_a_config_in_the_working_folder_is_part_of_the_hash(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    model = SimpleNamespace(infer=lambda observation: {"actions": pi0_droid(observation)})
    upstream = {
        "openpi.policies.policy_config": {"create_trained_policy": lambda config, folder: model},
        "openpi.training.config": {},
    }
    for name, names in upstream.items():
        for package in ("openpi", name.rpartition(".")[0], name):
            monkeypatch.setitem(sys.modules, package, ModuleType(package))
        vars(sys.modules[name]).update(names)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "model").mkdir()
    settings = replace(DROID_SETTINGS, options={"layout": "droid", "config": "my_config.py"})
    hashes = []
    for text in ("CONFIG = 1", "CONFIG = 2", "CONFIG = 1"):
        (tmp_path / "my_config.py").write_text(text)
        hashes.append(OpenpiPolicy("model", settings).metadata().checkpoint_hash)
    assert hashes[0] == hashes[2] != hashes[1]
    assert "openpi_config" in sys.modules, "it was run"


def test_a_picture_of_another_size_is_refused_before_it_is_sent() -> None:
    with stock_server(pi0_droid) as (address, asked), OpenpiPolicy(address, DROID_SETTINGS) as policy:
        small = {"side": np.zeros((64, 64, 3), np.uint8), "wrist": np.zeros((64, 64, 3), np.uint8)}
        with pytest.raises(InvalidInput, match="Resized"):
            policy.infer(Observation(images=small, state=seen_by_droid().state, instruction="push"))
        assert len(asked) == 1
