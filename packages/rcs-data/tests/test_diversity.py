"""By how much ways differ."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from rcs_data import Dataset, DatasetInfo, DatasetWriter, Feature
from rcs_data.diversity import MOST_EPISODES, diversity_of_ways, ways_of

LINE = np.linspace([0.0, 0.0], [1.0, 2.0], 5)
DETOUR = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 2.0]])


def test_straight_ways_do_not_differ_wherever_they_lead() -> None:
    assert diversity_of_ways([LINE, 3.0 * LINE[::-1], LINE + 1.0]) == pytest.approx(0.0, abs=1e-12)


def test_it_neither_depends_on_the_speed_nor_on_the_order() -> None:
    slow = np.repeat(DETOUR, 3, axis=0)
    assert diversity_of_ways([DETOUR, slow]) == pytest.approx(0.0, abs=1e-12)
    found = diversity_of_ways([LINE, DETOUR])
    assert found == pytest.approx(diversity_of_ways([DETOUR, LINE])) and found > 0.3
    assert diversity_of_ways([2.0 * LINE, 2.0 * DETOUR]) == pytest.approx(2.0 * found)


def test_the_ways_of_a_dataset_are_those_of_all_its_robots_and_no_more_than_can_be_compared(tmp_path: Path) -> None:
    features = tuple(
        Feature(key=f"observation/{name}/joints", shape=(2,), dtype="float64", unit="rad") for name in ("left", "right")
    )
    with DatasetWriter.open(
        tmp_path, DatasetInfo(instruction="", frequency=10.0, features=features, setup={})
    ) as writer:
        for number in range(MOST_EPISODES + 10):
            with writer.episode(f"{number:06d}", seed=number) as episode:
                for row in LINE:
                    episode.add({"observation/left/joints": row, "observation/right/joints": number + row})
                episode.finish(True, {})
    dataset = Dataset.open(tmp_path)
    ways = ways_of(dataset.info, list(dataset))
    assert len(ways) == MOST_EPISODES
    np.testing.assert_array_equal(ways[-1], np.hstack([LINE, MOST_EPISODES + 9 + LINE]))
    (tmp_path / "episodes/000000/steps.parquet").write_bytes(b"")
    assert len(ways_of(dataset.info, list(Dataset.open(tmp_path)))) == MOST_EPISODES - 1
