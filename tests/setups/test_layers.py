"""Layers of one's own: by name in the setup, as objects on top of it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import rcs
from rcs.envs.layers import BinaryGripper, Layer, LimitStep
from rcs.errors import InvalidSetup, UnknownName


class Shut(Layer):
    """Keep the gripper shut."""

    def map_action(self, action: Any) -> Any:
        return {**action, "gripper": np.zeros_like(action["gripper"])}


def names(env: Any) -> list[str]:
    return [type(layer).__name__ for layer in env.stack.layers]


def test_names_and_classes_become_part_of_the_setup() -> None:
    env = rcs.make("Free", layers=["rcs.envs.layers:BinaryGripper", Shut])
    assert env.setup.layers == ("rcs.envs.layers:BinaryGripper", f"{__name__}:Shut")
    assert names(env)[-2:] == ["BinaryGripper", "Shut"]
    again = rcs.make(rcs.Setup.from_json(env.setup.to_json()))
    assert str(again) == str(env)
    env.reset(seed=0)
    action = env.action_space.sample()
    action["gripper"][:] = 1.0
    _, _, _, _, info = env.step(action)
    assert info["target"]["gripper"] == 0.0


def test_an_object_and_what_lies_on_it_stay_outside() -> None:
    env = rcs.make("Free", layers=[Shut, LimitStep(np.full(7, 0.01), 0.6), BinaryGripper])
    assert env.setup.layers == (f"{__name__}:Shut",)
    assert names(env)[-3:] == ["Shut", "LimitStep", "BinaryGripper"]


def test_a_class_inside_of_a_function_has_no_name_and_stays_outside() -> None:
    class Inner(Layer):
        """A layer of this function."""

    env = rcs.make("Free", layers=[Inner])
    assert env.setup.layers == ()
    assert names(env)[-1] == "Inner"


def test_a_setup_with_layers_gets_more_on_top() -> None:
    env = rcs.make(rcs.Setup(task="Free", layers=(f"{__name__}:Shut",)), layers=[BinaryGripper])
    assert names(env)[-2:] == ["Shut", "BinaryGripper"]
    assert len(env.setup.layers) == 2


def test_several_robots_have_each_their_own_and_so_have_many_copies() -> None:
    env = rcs.make("Free", robot="dual_fr3", layers=[Shut])
    shut = [layer for layer in env.stack.layers if isinstance(layer, Shut)]
    assert len({id(layer) for layer in shut}) == 2
    envs = rcs.make_vec("Free", copies=2, layers=[Shut])
    assert envs.setup.layers == (f"{__name__}:Shut",)
    assert names(envs)[-1] == "Shut"


@pytest.mark.parametrize(
    ("layers", "error", "text"),
    [
        (["Shot"], UnknownName, "Shot"),
        ("rcs.envs.layers:BinaryGripper", InvalidSetup, "give a sequence"),
        ([Shut, Shut], InvalidSetup, "must not repeat"),
        ([int], InvalidSetup, "no layer"),
    ],
)
def test_what_is_no_layer_is_refused(layers: Any, error: type[Exception], text: str) -> None:
    with pytest.raises(error, match=text):
        rcs.make("Free", layers=layers)
