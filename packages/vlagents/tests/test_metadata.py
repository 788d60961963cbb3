from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace

import pytest
import vlagents
from vlagents import ImageSpec, InvalidInput, Metadata, Offer, PartSpec, differences

METADATA = Metadata(
    name="act",
    action=(PartSpec("joints", 7, "rad"), PartSpec("gripper", 1, "0 closed, 1 open")),
    images=(ImageSpec("wrist", 224, 224), ImageSpec("side")),
    state=(PartSpec("joints", 7, "rad"),),
    needs_instruction=True,
    needs_goal=True,
    horizon=50,
    rate=30.0,
    checkpoint="runs/act",
    checkpoint_hash="ab" * 32,
)
OFFER = Offer(
    action=(PartSpec("gripper", 1), PartSpec("joints", 7, "rad")),
    images=(ImageSpec("wrist", 224, 224), ImageSpec("side", 480, 640), ImageSpec("top", 10, 10)),
    state=(PartSpec("joints", 7, "rad"), PartSpec("tquat", 7)),
)


def test_metadata_and_offers_survive_json() -> None:
    assert Metadata.from_dict(json.loads(json.dumps(METADATA.to_dict()))) == METADATA
    assert Offer.from_dict(json.loads(json.dumps(OFFER.to_dict()))) == OFFER


def test_a_robot_that_shows_more_than_is_needed_fits() -> None:
    assert differences(METADATA, OFFER) == []


@pytest.mark.parametrize(
    ("offer", "said"),
    [
        (replace(OFFER, images=OFFER.images[1:]), "needs 'wrist'; the robot shows 'side', 'top'"),
        (
            replace(OFFER, images=(ImageSpec("wrist", 480, 224), *OFFER.images[1:])),
            "with height 224;",
        ),
        (replace(OFFER, state=()), "the policy needs 'joints'; the robot shows none"),
        (replace(OFFER, state=(PartSpec("joints", 6, "rad"),)), "size 7"),
        (replace(OFFER, action=(PartSpec("joints", 7, "deg"), PartSpec("gripper", 1))), "unit 'rad'"),
        (replace(OFFER, action=(PartSpec("joints", 7, "rad", "delta"), PartSpec("gripper", 1))), "meaning 'absolute'"),
        (replace(OFFER, action=OFFER.action[1:]), "the policy gives 'gripper'"),
        (replace(OFFER, action=(*OFFER.action, PartSpec("hand", 16))), "takes 'hand', which the policy does not give"),
        (replace(OFFER, has_instruction=False), "instruction"),
        (replace(OFFER, has_goal=False), "goal: the policy needs images of the goal, and none are sent here; call it"),
    ],
)
def test_each_difference_is_named(offer: Offer, said: str) -> None:
    (found,) = differences(METADATA, offer)
    assert said in found


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"name": ""}, "name of Metadata"),
        ({"horizon": 0}, "horizon"),
        ({"rate": float("nan")}, "rate"),
        ({"state": (PartSpec("a", 1), PartSpec("a", 2))}, "twice"),
    ],
)
def test_what_is_wrong_is_named(changes: dict[str, object], said: str) -> None:
    with pytest.raises(InvalidInput, match=said):
        replace(METADATA, **changes)  # type: ignore[arg-type]


def test_dictionaries_that_are_no_metadata_are_refused() -> None:
    for given in (
        None,
        [],
        {},
        {"name": 3},
        {**METADATA.to_dict(), "action": 5},
        {**METADATA.to_dict(), "images": [3]},
    ):
        with pytest.raises(InvalidInput):
            Metadata.from_dict(given)


@pytest.mark.parametrize("record", [METADATA, OFFER, PartSpec("joints", 7), ImageSpec("side")])
def test_records_cannot_be_changed(record: object) -> None:
    with pytest.raises(AttributeError):
        record.name = "other"  # type: ignore[attr-defined]


def test_vlagents_names_what_is_used_most_and_imports_it_when_it_is_used() -> None:
    code = "import sys, vlagents; assert 'vlagents.server' not in sys.modules; vlagents.Server, vlagents.Client"
    subprocess.run([sys.executable, "-c", code], check=True)
    assert callable(vlagents.connect)
    with pytest.raises(AttributeError, match="no attribute 'Servr'"):
        vlagents.Servr  # noqa: B018


MANY_THREADS = """
import threading, time
import msgspec._utils as utils
look = utils.get_class_annotations
utils.get_class_annotations = lambda kind: time.sleep(0.02) or look(kind)  # as on a busy machine
from vlagents import Metadata
values = {"name": "a", "action": [{"name": "joints", "size": 7}], "horizon": 1, "rate": 30.0}
threads = [threading.Thread(target=Metadata.from_dict, args=(values,)) for _ in range(8)]
for thread in threads:
    thread.start()
    time.sleep(0.011)
for thread in threads:
    thread.join()
"""


def test_many_threads_read_the_first_one_at_once() -> None:
    program = [sys.executable, "-c", MANY_THREADS]
    done = subprocess.run(program, capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stderr) == (0, "")
