"""Films of episodes that cannot be run again are what their recording has."""

from __future__ import annotations

from pathlib import Path

import av
import numpy as np
import pytest
from rcs_data import DatasetInfo, DatasetWriter, Feature
from rcs_data.ledger import Condition, Ledger, Row
from rcs_data.ledger.condition import key_of

from rcs.errors import InvalidSetup
from rcs.rollout.recorded_films import cut_films

CONDITION = Condition(agent="act", task="Pick", robot="fr3", setup={}, platform={"fr3": "franka"})
CAMERA = Feature(key="observation/frames/side/rgb", shape=(32, 48, 3), dtype="uint8", encoding="lossless")


def row_of(seed: int, success: bool) -> Row:
    return Row(
        key=key_of(CONDITION.hash, seed), condition=CONDITION.hash, seed=seed, agent="act", weights=None, trained=None,
        task="Pick", robot="fr3", is_real=True, success=success, failure=None, message=None, judge="person", steps=4,
        reward=0.0, latency_p50=None, latency_p99=None, seconds=1.0, ended="2026-11-26T12:00:00+00:00",
    )  # fmt: skip


@pytest.fixture
def ledger(tmp_path: Path) -> Ledger:
    """Three real episodes, the last of which failed."""
    made = Ledger.open(tmp_path / "ledger")
    made.register(CONDITION)
    for seed in range(3):
        made.add(row_of(seed, seed < 2))
    return made


def record(folder: Path, info: DatasetInfo, brightness: dict[str, int]) -> None:
    with DatasetWriter.open(folder, info) as writer:
        for name, grey in brightness.items():
            episode = writer.episode(name, seed=0)
            for _ in range(5):
                episode.add({CAMERA.key: np.full(CAMERA.shape, grey, np.uint8)})
            episode.finish(success=True)


def test_failures_come_first_and_the_last_of_two_recordings_counts(ledger: Ledger, tmp_path: Path) -> None:
    rows = sorted(ledger.rows.values(), key=lambda row: row.seed)
    brightness = {f"{row.seed:06d}-{row.name}": 40 * row.seed for row in rows} | {f"000002-{rows[2].name}-2": 200}
    record(tmp_path / "data", DatasetInfo(frequency=30.0, features=(CAMERA,), setup={}, instruction=""), brightness)
    made = cut_films(tmp_path / "data", ledger, CONDITION.hash, 2)
    assert [row.seed for row in made] == [2, 0]
    with av.open(str(ledger.film(rows[2]))) as film:
        pictures = [picture.to_ndarray(format="rgb24") for picture in film.decode(video=0)]
    assert len(pictures) == 5
    assert abs(float(np.mean(pictures)) - 200) < 4, "the kill has left the other one"
    assert cut_films(tmp_path / "data", ledger, CONDITION.hash, 2) == []


def test_a_recording_without_colour_is_refused(ledger: Ledger, tmp_path: Path) -> None:
    joints = Feature(key="observation/joints", shape=(7,), dtype="float64")
    with DatasetWriter.open(
        tmp_path / "data", DatasetInfo(frequency=30.0, features=(joints,), setup={}, instruction="")
    ):
        pass
    with pytest.raises(InvalidSetup, match="no colour camera"):
        cut_films(tmp_path / "data", ledger, CONDITION.hash, 2)
