"""Text and image as OpenVLA takes them; `make test-interop` asks a tiny model."""

from __future__ import annotations

import importlib
from typing import Any

import numpy as np
import pytest
from vlagents.policies.openvla import CROP, EMPTY, PROMPT, PROMPT_V01, end_with_empty, picture_for, prompt


@pytest.mark.parametrize("said", ["Pick up the cube", " pick up the Cube. ", "pick up the cube..."])
def test_an_instruction_is_in_lower_case_without_a_full_stop(said: str) -> None:
    assert prompt(PROMPT, said) == "In: What action should the robot take to pick up the cube?\nOut:"
    assert prompt(PROMPT_V01, said).endswith("take to pick up the cube? ASSISTANT:")


def test_a_cropped_picture_is_its_middle_at_the_same_size() -> None:
    pytest.importorskip("PIL")
    image = np.zeros((200, 400, 3), np.uint8)
    image[..., 0] = np.linspace(0, 200, 200, dtype=np.uint8)[:, None]
    image[..., 1] = np.linspace(0, 200, 400, dtype=np.uint8)
    np.testing.assert_array_equal(np.asarray(picture_for(image, False)), image)
    cropped = np.asarray(picture_for(image, True), float)
    assert cropped.shape == image.shape
    edge = 200 * (1 - np.sqrt(CROP)) / 2
    for channel, corner in ((0, cropped[0, 200]), (1, cropped[100, 0])):
        assert corner[channel] == pytest.approx(edge, abs=1.5)
    np.testing.assert_allclose(cropped[100, 200], image[100, 200], atol=1.5)


@pytest.mark.extras
@pytest.mark.parametrize("tokens", [[1, 5, 7], [1, 5, EMPTY]])
def test_a_text_ends_with_one_empty_token_and_all_of_it_counts(tokens: list[int]) -> None:
    torch: Any = importlib.import_module("torch")
    given = {"input_ids": torch.tensor([tokens]), "attention_mask": torch.ones((1, 3), dtype=torch.long)}
    end_with_empty(torch, given)
    told = given["input_ids"].tolist()[0]
    assert told == [1, 5, *(token for token in (7,) if token in tokens), EMPTY]
    assert given["attention_mask"].tolist() == [[1] * len(told)]
