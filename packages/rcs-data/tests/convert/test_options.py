"""Laws of all exports: their options, an output that is there already, and a package that is missing."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rcs_data import Dataset, DatasetInfo, DatasetWriter, Feature
from rcs_data.convert import ExportOptions, ImportOptions, export_lerobot, export_rlds, export_robomimic
from rcs_data.convert.mcap.export import export_mcap
from rcs_data.errors import DatasetError, InvalidSetup, MissingDependency

EXPORTS = [export_lerobot, export_rlds, export_robomimic, pytest.param(export_mcap, marks=pytest.mark.extras)]


@pytest.fixture
def uneven(tmp_path: Path) -> Dataset:
    """Episodes of 4, 1, 1, 3 and 2 rows; the third and the last failed."""
    features = tuple(Feature(key=f"{part}/joints", shape=(2,), dtype="float64") for part in ("observation", "action"))
    info = DatasetInfo(frequency=30.0, features=features, setup={}, instruction="pick")
    with DatasetWriter.open(tmp_path / "uneven", info) as writer:
        for name, rows in (("a", 4), ("b", 1), ("c", 1), ("d", 3), ("e", 2)):
            with writer.episode(name, seed=0) as episode:
                for row in range(rows):
                    episode.add({f.key: np.full(2, row / 4) for f in (features if row else features[:1])})
                episode.finish(name not in ("c", "e"))
    return Dataset.open(tmp_path / "uneven")


@pytest.mark.parametrize("export", EXPORTS)
def test_chosen_episodes_without_a_step_are_left_out_and_named(uneven: Dataset, tmp_path: Path, export: Any) -> None:
    def left_out(**choices: Any) -> tuple[int, list[str]]:
        report = export(uneven, tmp_path / f"out{len([*tmp_path.iterdir()])}", ExportOptions(cameras=(), **choices))
        return report.episodes, [note.rpartition(": ")[2] for note in report.notes if "no step" in note]

    assert left_out(episodes=("a", "d")) == (2, [])
    assert left_out(episodes=("d", "b")) == (1, ["b."])
    assert left_out() == (3, ["b, c."])
    assert left_out(success_only=True) == (2, ["b."])


@pytest.mark.parametrize("export", EXPORTS)
def test_where_nothing_is_left_the_error_names_what_was_chosen(uneven: Dataset, tmp_path: Path, export: Any) -> None:
    with pytest.raises(InvalidSetup, match="no step: b, c"):
        export(uneven, tmp_path / "out", ExportOptions(episodes=("b", "c")))
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("export", EXPORTS)
@pytest.mark.parametrize(
    ("choices", "told"),
    [
        ({"episodes": ("y", "a", "z")}, "no episode y, z in"),
        ({"episodes": ("a", "a")}, "given twice: a"),
        ({"episodes": ()}, "is one with a step"),
        ({"episodes": ("e",), "success_only": True}, "is one that succeeded"),
        ({"cameras": ("top",)}, "no camera of this dataset named 'top'"),
    ],
)
def test_a_choice_that_cannot_be_is_refused_and_leaves_nothing(
    uneven: Dataset, tmp_path: Path, export: Any, choices: Any, told: str
) -> None:
    before = sorted(tmp_path.iterdir())
    with pytest.raises(InvalidSetup, match=told):
        export(uneven, tmp_path / "out", ExportOptions(**choices))
    assert sorted(tmp_path.iterdir()) == before


@pytest.mark.parametrize("export", EXPORTS)
def test_an_export_that_is_there_is_not_written_over(uneven: Dataset, tmp_path: Path, export: Any) -> None:
    def files() -> dict[Path, bytes]:
        return {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}

    export(uneven, tmp_path / "out")
    before = files()
    with pytest.raises(DatasetError, match="exists already"):
        export(uneven, tmp_path / "out")
    assert files() == before


@pytest.mark.parametrize(
    ("export", "package", "extra"),
    [
        (export_robomimic, "h5py", "hdf5"),
        (export_rlds, "tfrecord.writer", "rlds"),
        (export_mcap, "mcap.writer", "mcap"),
    ],
)
def test_without_a_package_the_error_names_the_extra(
    uneven: Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, export: Any, package: str, extra: str
) -> None:
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(MissingDependency, match=rf"rcs-data\[{extra}\]"):
        export(uneven, tmp_path / "out")
    assert not [path for path in (tmp_path / "out", *tmp_path.glob("out/**/*")) if path.is_file()]


@pytest.mark.parametrize(
    ("export", "choices", "told"),
    [
        (export_lerobot, {"normalise": True}, "LeRobot has no use for normalise"),
        (export_robomimic, {"extra": ("nope",), "codec": "av1"}, "robomimic has no use for extra, codec"),
        (export_rlds, {"fps": 30}, "RLDS has no use for fps"),
    ],
)
def test_options_that_a_format_does_not_use_are_refused(
    uneven: Dataset, tmp_path: Path, export: Any, choices: Any, told: str
) -> None:
    with pytest.raises(InvalidSetup, match=told):
        export(uneven, tmp_path / "out", ExportOptions(**choices))
    assert not (tmp_path / "out").exists()


def test_options_of_imports_that_make_no_sense_are_refused() -> None:
    with pytest.raises(InvalidSetup, match="frequency is 0"):
        ImportOptions(frequency=0)
