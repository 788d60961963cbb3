"""Policies behind an address: two robots at one server, servers that die or speak openpi's wire, and what fits."""

from __future__ import annotations

import json
import subprocess
import sys
import threading
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from vlagents import ConnectionLost, ImageSpec, Metadata, Observation, PartSpec, Server
from vlagents.policies.scripted import ScriptedPolicy
from vlagents.wire.openpi import pack, unpack

import rcs
from rcs.agents import agent_for
from rcs.envs import Env
from rcs.errors import InvalidSetup, RcsError
from rcs.policy import Execution, ServedPolicy, fitted
from tests.policy.swing import GRIPPER, JOINTS


def test_two_robots_with_different_instructions_on_one_server_are_kept_apart() -> None:
    def act(seen: Observation, instruction: str) -> np.ndarray:
        sign = {"up": 1.0, "down": -1.0}[instruction]
        return np.tile([*(seen.state["joints"] + 0.05 * sign), 1.0], (8, 1))

    metadata = Metadata(name="two", state=(JOINTS,), action=(JOINTS, GRIPPER), rate=30.0, horizon=8)
    with Server(ScriptedPolicy(act, metadata), port=0) as server:
        sides = []
        for word in ("up", "down"):
            env = rcs.make("Free", robot="fr3", relative=False)
            agent = ServedPolicy(address=str(server.address), instruction=word)(env)
            observation, info = env.reset(seed=0)
            agent.reset(observation, info)
            sides.append([env, agent, observation, info, np.array(observation["joints"])])
        for _ in range(20):
            for side in sides:
                env, agent, observation, info, _ = side
                side[2], *_, side[3] = env.step(agent.act(observation, info))
        for (env, agent, observation, _, start), sign in zip(sides, (1, -1), strict=True):
            assert (sign * (observation["joints"] - start) > 0.05).all()
            agent.close()
            env.close()


_SERVE = """
import sys, time
import numpy as np
from vlagents import Metadata, PartSpec
from vlagents.policies.scripted import ScriptedPolicy
from vlagents import Server
from vlagents.wire.openpi import pack, unpack

joints, gripper = PartSpec("joints", 7, "rad"), PartSpec("gripper", 1, "0 closed, 1 open")
metadata = Metadata(name="swing", state=(joints,), action=(joints, gripper), rate=30.0, horizon=16)
act = lambda seen, _: np.hstack([seen.state["joints"] + 0.02 * np.arange(1, 17)[:, None], np.ones((16, 1))])
with Server(ScriptedPolicy(act, metadata), port=int(sys.argv[1])) as server:
    print(server.address.port, flush=True)
    server.serve_forever()
"""


def serve(port: int = 0) -> tuple[subprocess.Popen[str], int]:
    process = subprocess.Popen([sys.executable, "-c", _SERVE, str(port)], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    return process, int(process.stdout.readline())


@pytest.mark.parametrize("on_loss", ["reconnect", "end"])
def test_a_server_that_is_killed_means_hold_and_what_the_options_say(
    env: Env, on_loss: Any, caplog: pytest.LogCaptureFixture
) -> None:
    process, port = serve()
    served = ServedPolicy(address=f"vla://127.0.0.1:{port}", execution=Execution(on_loss=on_loss, retry=0.2))
    agent = served(env)
    try:
        observation, info = env.reset(seed=0)
        agent.reset(observation, info)
        for _ in range(10):
            observation, *_, info = env.step(agent.act(observation, info))
        process.kill()
        process.wait()
        for _ in range(20):
            observation, *_, info = env.step(agent.act(observation, info))
        held = np.array(observation["joints"])
        assert isinstance(agent._executor.error, ConnectionLost)
        assert "ConnectionLost" in caplog.text
        for _ in range(10):
            observation, *_, info = env.step(agent.act(observation, info))
        np.testing.assert_allclose(observation["joints"], held, atol=1e-3)
        assert agent.failure == "policy"
        assert agent.events() == (("stop",) if on_loss == "end" else ())
        if on_loss == "reconnect":
            process, _ = serve(port)
            for _ in range(20):
                observation, *_, info = env.step(agent.act(observation, info))
            assert agent._executor.error is None
            assert np.abs(observation["joints"] - held).max() > 0.02
    finally:
        process.kill()
        process.wait()
        agent.close()


def test_where_nobody_is_the_error_says_so(env: Env) -> None:
    with pytest.raises(RcsError, match="ConnectionLost: No server is at"):
        agent_for(env, "vla://127.0.0.1:1")


def test_a_server_of_openpi_is_run_with_metadata_from_a_file(env: Env, tmp_path: Path) -> None:
    from websockets.sync.server import ServerConnection, serve

    def converse(connection: ServerConnection) -> None:
        connection.send(pack({}))  # openpi's servers tell no metadata
        for message in connection:
            joints = unpack(message)["joints"]
            connection.send(pack({"actions": np.tile([*(joints + 0.05), 1.0], (8, 1))}))

    path = tmp_path / "metadata.json"
    metadata = Metadata(name="pi", state=(JOINTS,), action=(JOINTS, GRIPPER), rate=30.0, horizon=8)
    path.write_text(json.dumps(metadata.to_dict()))
    with serve(converse, "127.0.0.1", 0) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        address = f"ws://127.0.0.1:{server.socket.getsockname()[1]}"
        with pytest.raises(InvalidSetup, match="takes 'joints', which the policy does not give"):
            ServedPolicy(address=address)(env)
        agent = ServedPolicy(address=address, described_in=str(path))(env)
        start, info = env.reset(seed=0)
        agent.reset(start, info)
        observation = start
        for _ in range(6):
            observation, *_, info = env.step(agent.act(observation, info))
        assert (observation["joints"] - start["joints"] > 0.02).all()
        agent.close()
        server.shutdown()
    with pytest.raises(InvalidSetup, match="sends its own metadata"):
        ServedPolicy(address="vla://127.0.0.1:1", described_in=str(path)).connect()
    with pytest.raises(RcsError, match=r"at gr00t://127\.0\.0\.1:1"):
        ServedPolicy(address="gr00t://127.0.0.1:1", described_in=str(path)).connect()


def test_a_setup_takes_what_the_policy_names() -> None:
    metadata = Metadata(
        name="sees",
        state=(PartSpec("privileged/cuboid/tquat", 7), PartSpec("is_grasped", 1)),
        action=(PartSpec("tquat", 7, "m, xyzw", "delta"), GRIPPER),
    )
    setup = fitted(rcs.Setup(), metadata)
    assert (setup.control, setup.relative, setup.observe) == ("tquat", "last_step", ("privileged", "contacts"))
    assert fitted(rcs.Setup(), metadata, {"control", "relative"}).control == "joints"
    counts = replace(metadata, state=(PartSpec("target/joints", 7, "rad"),))
    assert fitted(rcs.Setup(), counts).layers == ("ObserveTarget",)
    assert fitted(fitted(rcs.Setup(), counts), counts).layers == ("ObserveTarget",)


def test_cameras_of_different_sizes_have_those_that_the_policy_names() -> None:
    images = (ImageSpec("wrist", 240, 320), ImageSpec("side", 128, 128))
    metadata = Metadata(name="sees", images=images, action=(JOINTS, GRIPPER))
    cameras = fitted(rcs.Setup(cameras="all"), metadata).cameras
    assert cameras.names == ("wrist", "side")
    assert [cameras.size_of(name) for name in cameras] == [(320, 240), (128, 128)]
    assert fitted(rcs.Setup(cameras="wrist"), metadata, {"cameras"}).cameras == rcs.Cameras(names=("wrist",))
    same = replace(metadata, images=(images[0], replace(images[0], name="side")))
    assert fitted(rcs.Setup(), same).cameras.image_size == (320, 240)


def test_without_vlagents_the_error_names_the_extra(run_program: Any) -> None:
    program = """
    import sys
    sys.modules["vlagents"] = None
    import rcs, rcs.policy
    from rcs.errors import MissingDependency
    try:
        rcs.policy.ServedPolicy(address="vla://127.0.0.1:1").connect()
    except MissingDependency as err:
        print(err)
    """
    assert "robot-control-stack[policy]" in run_program(program).stdout
