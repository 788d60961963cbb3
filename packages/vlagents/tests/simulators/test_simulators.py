from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from vlagents import Client, InvalidInput, Observation, PolicyFailed, Server
from vlagents.errors import MissingSimulator, SimulatorTaken
from vlagents.simulators.client import SimulatorClient
from vlagents.simulators.interface import Facts, PartMap, SimulatorMapping
from vlagents.simulators.served import BUILT_IN, ServedSimulator, load

sys.path.insert(0, str(Path(__file__).parent))
TINY = "tiny_simulator:Reach"


@pytest.fixture
def served() -> Iterator[Server]:
    with Server(load(f"{TINY}:near"), port=0) as server:
        yield server


def simulator(server: Server, **changes: Any) -> SimulatorClient:
    address = str(server.address)
    if not changes:
        return SimulatorClient(address)
    with SimulatorClient(address) as client:
        return SimulatorClient(address, replace(client.mapping, **changes))


def rows(client: SimulatorClient, seed: int, count: int = 60) -> list[bytes]:
    moment, found = client.begin(seed), []
    while not moment.is_over and len(found) < count:
        way = moment.observation.state["goal"] - moment.observation.state["tquat"][:3]
        moment = client.advance([*np.clip(way, -0.01, 0.01), 0.0, 0.0, 0.1, 1.0])
        arrays = [*moment.observation.state.values(), *moment.observation.images.values()]
        found.append(b"".join(array.tobytes() for array in arrays))
    assert count < 60 or moment.success
    return found


def test_the_same_seed_gives_the_same_rows_and_another_start_gives_others(served: Server) -> None:
    with simulator(served) as client:
        first = rows(client, 0)
        assert rows(client, 1) != first
        assert rows(client, 0) == first
        assert rows(client, 4) == first, "the seed picks one of four stored starts"
    with simulator(served, start="drawn") as client:
        assert rows(client, 4) != rows(client, 0)


def test_pictures_are_turned_units_converted_and_steps_limited(served: Server) -> None:
    with simulator(served, steps=3) as client:
        moment = client.begin(0)
        image = moment.observation.image("front")
        assert image[-1].min() == 255
        assert image[:-1].max() == 0, "the first row is the last one"
        assert moment.observation.state["gripper"] == 1.0, "open since the two steps of waiting"
        assert moment.observation.instruction == "reach the goal"
        half = client.advance([0.0, 0.0, 0.005, 0.0, 0.0, 0.0, 0.25]).observation
        np.testing.assert_allclose(half.state["tquat"][:3], [0.0, 0.0, 0.005])
        np.testing.assert_allclose(half.state["gripper"], 0.25)
        assert half.time == pytest.approx(0.05)
        assert not client.advance(np.zeros(7)).is_over
        assert client.advance(np.zeros(7)).is_over


def test_a_mapping_that_does_not_fit_is_refused_with_all_differences(served: Server) -> None:
    with simulator(served) as client:
        own = client.mapping
    arm, grip = own.action
    wrong = replace(
        own,
        images=(replace(own.images[0], camera="back"),),
        state=(PartMap(name="joints", of=("angles",), unit="rad"), replace(own.state[2], rotation="intrinsic_xyz")),
        action=(replace(arm, scale=(1.0, 2.0), of=("way", "way", "turn")), replace(grip, scale=(0.0,))),
        wait_action=(0.0,),
        steps=99,
    )
    with pytest.raises(InvalidInput) as caught:
        SimulatorClient(str(served.address), wrong)
    expected = ("'back'; there are 'front'", "'angles'; there are", "no rotation", "scale of 'xyzrpy' has 2", "(0.0,)")
    for part in (*expected, "set each of 'way', 'turn', 'grip' once", "it has 1 numbers", "2 + 99 are more"):
        assert part in str(caught.value), part
    facts = load(f"{TINY}:far").facts
    with pytest.raises(InvalidInput, match="no stored starts"):
        own.check(replace(facts, starts=0))


def test_a_mapping_with_two_of_a_name_or_a_part_of_nothing_is_refused(served: Server) -> None:
    with simulator(served) as client:
        own = client.mapping
    for wrong, words in (
        (replace(own, images=own.images * 2), "images: 'front' is there twice"),
        (replace(own, state=(*own.state, own.state[0])), "state: 'tquat' is there twice"),
        (replace(own, state=(PartMap(name="empty", of=()),)), "state: 'empty' is of nothing; there are 'pose'"),
    ):
        with pytest.raises(InvalidInput, match=words):
            SimulatorClient(str(served.address), wrong)


def test_a_mapping_survives_json_and_every_field_is_part_of_it(served: Server) -> None:
    with simulator(served) as client:
        mapping, facts = client.mapping, client.facts
    assert SimulatorMapping.from_dict(mapping.to_dict()) == mapping
    assert Facts.from_dict(facts.to_dict()) == facts
    assert set(mapping.to_dict()) == set(SimulatorMapping.__dataclass_fields__)


def test_a_change_of_the_source_of_a_simulator_changes_its_facts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(str(tmp_path))
    source = tmp_path / "own_simulator.py"
    source.write_text(Path(__file__).with_name("tiny_simulator.py").read_text())
    one, same = load("own_simulator:Reach:near").facts, load("own_simulator:Reach:near").facts
    source.write_text(f"{source.read_text()}\n# a change\n")
    other = load("own_simulator:Reach:near").facts
    assert one == same
    assert one.versions["tiny"] == other.versions["tiny"]
    assert one != other


@given(st.lists(st.floats(-1.4, 1.4), min_size=3, max_size=3))
def test_rotations_are_the_same_in_every_form(rpy: list[float]) -> None:
    def about(axis: int, angle: float) -> np.ndarray:
        c, s, turned = np.cos(angle), np.sin(angle), np.eye(3)
        i, j = [(1, 2), (2, 0), (0, 1)][axis]
        turned[i, i], turned[i, j], turned[j, i], turned[j, j] = c, -s, s, c
        return turned

    wanted = about(2, rpy[2]) @ about(1, rpy[1]) @ about(0, rpy[0])
    part = PartMap(name="xyzrpy", of=("turn",), rotation="intrinsic_xyz")
    x, y, z = part.to_simulator(np.array(rpy))
    np.testing.assert_allclose(about(0, x) @ about(1, y) @ about(2, z), wanted, atol=1e-9)
    vector = replace(part, rotation="rotation_vector").to_simulator(np.array(rpy))
    angle = float(np.linalg.norm(vector))
    k = np.cross(np.eye(3), vector / angle if angle > 1e-12 else vector)
    rodrigues = np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k
    np.testing.assert_allclose(rodrigues, wanted, atol=1e-7)


@pytest.mark.parametrize("fault", ["nan", "reward", "raise"])
def test_what_is_no_number_and_what_fails_is_an_error_and_the_next_episode_works(fault: str) -> None:
    with Server(load(f"{TINY}:near", {"fault": fault}), port=0) as server, simulator(server) as client:
        client.begin(0)
        client.advance(np.zeros(7))
        with pytest.raises(PolicyFailed if fault == "raise" else InvalidInput, match=r"on purpose|not finite|is nan"):
            rows(client, 1, count=5)
        assert len(rows(client, 0)) > 3


def test_actions_that_are_no_numbers_never_get_to_the_simulator(served: Server) -> None:
    with simulator(served) as client:
        client.begin(0)
        for wrong in (np.zeros(6), np.full(7, np.inf)):
            with pytest.raises(InvalidInput, match="7 finite numbers"):
                client.advance(wrong)


def test_a_simulator_serves_one_client_and_gives_no_actions(served: Server) -> None:
    with simulator(served) as first, simulator(served) as second:
        second.begin(0)
        with pytest.raises(SimulatorTaken, match="Another client has opened"):
            first.begin(0)
    with Client(str(served.address)) as client, pytest.raises(InvalidInput, match="simulator, not a policy"):
        client.infer(Observation())


def test_unknown_names_list_the_known_ones() -> None:
    for name in BUILT_IN:
        with pytest.raises(InvalidInput, match=f"{name}:TASK"):
            load("gazebo:pick")
    with pytest.raises(InvalidInput, match="near, far"):
        load(f"{TINY}:nearby")
    with pytest.raises(InvalidInput, match="no option --speed; valid: --fault, --bad_seed"):
        load(f"{TINY}:near", {"speed": "2"})
    with pytest.raises(InvalidInput, match="module:Class:task"):
        load("tiny_simulator:Grasp:near")


def test_a_simulator_that_is_not_installed_says_where_it_would_be() -> None:
    with pytest.raises(MissingSimulator, match=r"'metaworld'.*make sims"):
        load("metaworld:reach-v3")


def test_a_served_simulator_may_be_closed_twice() -> None:
    simulator = load(f"{TINY}:near")
    assert isinstance(simulator, ServedSimulator)
    with Server(simulator, port=0):
        pass
    simulator.close()
