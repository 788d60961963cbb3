from __future__ import annotations

import numpy as np
import pytest
from vlagents import InvalidInput, Observation, PartSpec


def test_numbers_come_side_by_side_in_the_order_of_the_parts() -> None:
    observation = Observation(state={"gripper": np.ones(1), "joints": np.arange(3.0)})
    parts = (PartSpec("joints", 3), PartSpec("gripper", 1))
    assert observation.numbers(parts).tolist() == [0.0, 1.0, 2.0, 1.0]
    with pytest.raises(InvalidInput, match="is missing"):
        observation.numbers((PartSpec("hand", 4),))
    with pytest.raises(InvalidInput, match=r"shape \(3,\); valid is \(7,\)"):
        observation.numbers((PartSpec("joints", 7),))


def test_a_picture_of_another_size_is_refused_where_the_model_has_one() -> None:
    image = np.zeros((4, 6, 3), np.uint8)
    observation = Observation(images={"side": image}, goals={"side": image})
    assert observation.image("side") is image
    assert observation.goal("wrist") is None
    for find in (observation.image, observation.goal):
        with pytest.raises(InvalidInput, match="4 x 6 pixels; the model takes 8 x 8"):
            find("side", 8, 8)
