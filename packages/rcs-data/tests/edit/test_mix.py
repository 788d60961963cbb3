from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from rcs_data import Dataset, DatasetInfo, DatasetWriter, Feature, check, edit
from rcs_data.edit import Harmonise, Part, mix, parse_part
from rcs_data.errors import DatasetError, InvalidSetup

if TYPE_CHECKING:
    from conftest import MakeDataset

RGB, DEPTH = "observation/frames/wrist/rgb", "observation/frames/wrist/depth"


@pytest.fixture
def real(tmp_path: Path, make_dataset: MakeDataset) -> Path:
    return make_dataset(
        tmp_path / "real",
        [5, 7, 4, 6],
        seed=1,
        sim_state_size=3,
        setup={"robot": "fr3", "lab": "ours", "relative": "last_step"},
    )


@pytest.fixture
def sim(tmp_path: Path, make_dataset: MakeDataset) -> Path:
    return make_dataset(tmp_path / "sim", [4, 6, 5, 8, 3], seed=2)


def test_a_mix_has_as_many_of_each_as_asked_and_says_where_each_came_from(
    tmp_path: Path, real: Path, sim: Path
) -> None:
    mixed = mix([Part(path=real, episodes=3), Part(path=sim, episodes=4)], tmp_path / "mix", seed=5)
    assert check(mixed.path).is_ok
    sources = [episode.source for episode in mixed.episodes]
    origin = [source["dataset"] for source in sources if source]
    assert (origin.count("real"), origin.count("sim"), len(mixed)) == (3, 4, 7)
    datasets = {"real": Dataset.open(real), "sim": Dataset.open(sim)}
    for episode, source in zip(mixed.episodes, sources, strict=True):
        assert source is not None
        before = datasets[source["dataset"]][source["episode"]]
        assert source["digest"] == datasets[source["dataset"]].digest()
        assert episode.content_hash == before.content_hash
        np.testing.assert_array_equal(episode.column(RGB), before.column(RGB))
    assert mixed.info.origin["mix"] == {"seed": 5, "parts": {"real": 3, "sim": 4}}
    assert mixed.info.sim_state_size is None  # states of two simulations are in no one


def test_the_seed_decides_which(tmp_path: Path, real: Path, sim: Path) -> None:
    def drawn(seed: int, name: str) -> list[str]:
        parts = [Part(path=real, episodes=2), Part(path=sim, episodes=2)]
        return [episode.id for episode in mix(parts, tmp_path / name, seed=seed).episodes]

    assert drawn(1, "a") == drawn(1, "b")
    assert len({tuple(drawn(seed, str(seed))) for seed in range(6)}) > 1


def test_shares_are_of_the_total(tmp_path: Path, real: Path, sim: Path) -> None:
    mixed = mix([Part(path=real, share=1), Part(path=sim, share=2)], tmp_path / "mix", total=6)
    assert mixed.info.origin["mix"]["parts"] == {"real": 2, "sim": 4}


@pytest.mark.parametrize(
    ("parts", "total", "message"),
    [
        ([("real", 9, None)], None, "at most 4 episodes of .*real; got 9"),
        ([("real", None, 0.5), ("sim", None, 0.5)], None, "total"),
        ([("real", None, 0.5), ("sim", 2, None)], 4, "every part"),
        ([("real", 2, None)], 4, "needs a share"),
        ([], None, "nothing to mix"),
    ],
)
def test_numbers_that_do_not_go_together_are_refused(
    tmp_path: Path, real: Path, sim: Path, parts: list[Any], total: int | None, message: str
) -> None:
    paths = {"real": real, "sim": sim}
    with pytest.raises(InvalidSetup, match=message):
        mix([Part(path=paths[name], episodes=n, share=w) for name, n, w in parts], tmp_path / "mix", total=total)
    assert not (tmp_path / "mix").exists()


def test_other_features_are_refused_with_what_differs_or_mapped(tmp_path: Path, real: Path, sim: Path) -> None:
    edit.resize(real, (12, 8))
    edit.rename_camera(real, "wrist", "hand")
    edit.resample(sim, 10)
    parts = [Part(path=real), Part(path=sim)]
    with pytest.raises(
        DatasetError, match=r"(?s)real and sim do not fit.*frequency: real has 30.0, sim has 10.0\n.*frames/hand"
    ):
        mix(parts, tmp_path / "mix")
    how = Harmonise(rename={"real": {"hand": "wrist"}}, size=(12, 8), frequency=10)
    mixed = mix(parts, tmp_path / "mix", mapping=how)
    assert check(mixed.path).is_ok, str(check(mixed.path))
    assert (mixed.info.frequency, mixed.info.feature(RGB).shape, len(mixed)) == (10, (8, 12, 3), 9)
    for episode in mixed.episodes:
        joints = episode.column("observation/joints")
        np.testing.assert_allclose(np.diff(joints, axis=0), episode.column("action/joints")[1:], atol=1e-12)


def test_cameras_that_swap_their_names_swap_their_images(tmp_path: Path) -> None:
    keys = [f"observation/frames/{name}/rgb" for name in ("front", "side")]
    features = tuple(Feature(key=key, shape=(8, 8, 3), dtype="uint8", encoding="lossless") for key in keys)
    info = DatasetInfo(frequency=10.0, features=features, setup={}, instruction="")
    for name in ("a", "b"):
        with DatasetWriter.open(tmp_path / name, info) as writer, writer.episode(name, seed=0) as episode:
            episode.add({key: np.full((8, 8, 3), 10 * (n + 1), np.uint8) for n, key in enumerate(keys)})
            episode.finish(None)
    how = Harmonise(rename={"b": {"front": "side", "side": "front"}})
    mixed = mix([Part(path=tmp_path / "a"), Part(path=tmp_path / "b")], tmp_path / "mix", mapping=how)
    assert [int(mixed[name].column(keys[0]).max()) for name in ("a", "b")] == [10, 20]
    assert check(mixed.path).is_ok


def test_relative_and_absolute_actions_do_not_mix(tmp_path: Path, make_dataset: MakeDataset, sim: Path) -> None:
    other = make_dataset(tmp_path / "absolute", [4], setup={"robot": "fr3", "relative": "absolute"})
    with pytest.raises(DatasetError, match=r"setup\.relative: actions are 'last_step' in sim and 'abs"):
        mix([Part(path=sim), Part(path=other)], tmp_path / "mix")


def test_actions_of_which_nothing_is_said_count_as_absolute(
    tmp_path: Path, make_dataset: MakeDataset, sim: Path
) -> None:
    silent = make_dataset(tmp_path / "silent", [4], setup={"robot": "fr3"})
    absolute = make_dataset(tmp_path / "absolute", [4], setup={"robot": "fr3", "relative": "absolute"})
    for paths in ((sim, silent), (silent, sim)):
        with pytest.raises(DatasetError, match=r"setup\.relative: actions are .*'last_step' in sim"):
            mix([Part(path=path) for path in paths], tmp_path / "mix")
    assert len(mix([Part(path=silent), Part(path=absolute)], tmp_path / "mix")) == 2


def test_what_only_some_have_can_be_left_out(tmp_path: Path, real: Path, sim: Path) -> None:
    edit.rename_camera(real, "wrist", "front")
    mixed = mix([Part(path=real), Part(path=sim)], tmp_path / "common", mapping=Harmonise(common=True))
    keys = [feature.key for feature in mixed.info.features]
    assert "observation/joints" in keys
    assert not [key for key in keys if "frames" in key]
    assert check(mixed.path).is_ok
    dropped = mix([Part(path=sim)], tmp_path / "dropped", mapping=Harmonise(drop=("observation/frames/wrist/depth",)))
    assert DEPTH not in [feature.key for feature in dropped.info.features]
    assert RGB in [feature.key for feature in dropped.info.features]
    assert dropped.info.sim_state_size == 3  # one simulation: its states stay
    assert check(dropped.path).is_ok


def test_features_to_leave_out_that_are_not_there_are_named(tmp_path: Path, sim: Path) -> None:
    how = Harmonise(drop=("observation/frames/wrist/dept",))
    with pytest.raises(InvalidSetup, match="drop has observation/frames/wrist/dept, which no dataset has"):
        mix([Part(path=sim)], tmp_path / "mix", mapping=how)


def test_codes_with_other_words_do_not_mix(tmp_path: Path, make_dataset: MakeDataset, sim: Path) -> None:
    info = Dataset.open(sim).info
    for name, words in (("a", ("policy", "person")), ("b", ("page", "agent"))):
        note = Feature(key="notes/actor", shape=(), dtype="uint8", words=words)
        DatasetWriter.open(tmp_path / name, replace(info, features=(*info.features, note))).close()
    with pytest.raises(DatasetError, match=r"(?s)notes/actor: a has .*policy.*b has .*page"):
        mix([Part(path=tmp_path / "a"), Part(path=tmp_path / "b")], tmp_path / "mix")


def test_another_number_of_joints_is_refused(tmp_path: Path, make_dataset: MakeDataset, sim: Path) -> None:
    info = Dataset.open(sim).info
    features = [replace(f, shape=(5,)) if f.key.endswith("joints") else f for f in info.features]
    other = tmp_path / "other"
    DatasetWriter.open(other, replace(info, features=tuple(features))).close()
    with pytest.raises(DatasetError, match=r"(?s)observation/joints: sim has '\(2,\).*other has '\(5,\)"):
        mix([Part(path=sim), Part(path=other)], tmp_path / "mix", mapping=Harmonise(common=True))


@pytest.mark.parametrize(
    ("text", "part"),
    [
        ("a/b:143", Part(path=Path("a/b"), episodes=143)),
        ("sim:0.7", Part(path=Path("sim"), share=0.7)),
        ("sim", Part(path=Path("sim"))),
        ("c:/d:2", Part(path=Path("c:/d"), episodes=2)),
    ],
)
def test_a_part_can_be_written_in_one_word(text: str, part: Part) -> None:
    assert parse_part(text) == part


def test_a_word_that_is_no_part_is_refused() -> None:
    with pytest.raises(InvalidSetup, match="DATASET:143"):
        parse_part("sim:many")


@pytest.mark.parametrize("total", [-4, 0])
def test_a_total_is_a_number_of_episodes(tmp_path: Path, real: Path, total: int) -> None:
    with pytest.raises(InvalidSetup, match=f"total is {total}; valid is a whole number from 1"):
        edit.mix([Part(path=real, share=1.0)], tmp_path / "out", total=total)
    with pytest.raises(InvalidSetup, match=r"share is inf; valid: a finite number above 0"):
        Part(path=real, share=float("inf"))
    with pytest.raises(InvalidSetup, match="The seed is -1"):
        edit.mix([Part(path=real)], tmp_path / "out", seed=-1)


def test_numbers_of_numpy_are_numbers(tmp_path: Path, real: Path) -> None:
    parts = [Part(path=real, episodes=np.int64(2))]  # pyright: ignore[reportArgumentType]
    mixed = mix(parts, tmp_path / "a", seed=np.int64(5))  # pyright: ignore[reportArgumentType]
    assert mixed.digest() == mix([Part(path=real, episodes=2)], tmp_path / "b", seed=5).digest()


def test_numbers_of_episodes_are_whole(tmp_path: Path, real: Path) -> None:
    with pytest.raises(InvalidSetup, match=r"total is 2.5; valid is a whole number from 1"):
        mix([Part(path=real, share=1.0)], tmp_path / "out", total=2.5)  # pyright: ignore[reportArgumentType]
    with pytest.raises(InvalidSetup, match=r"episodes is 1\.5; valid: a whole number from 0"):
        Part(path=real, episodes=1.5)  # pyright: ignore[reportArgumentType]


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"frequency": "5"}, "frequency is '5'; valid: a finite number above 0"),
        ({"drop": "observation/x"}, r"Give a sequence, such as \('observation/x',\)"),
        ({"size": (12,)}, "size is .*; valid: a sequence of 2"),
    ],
)
def test_a_mapping_that_makes_no_sense_is_refused(given: dict[str, Any], message: str) -> None:
    with pytest.raises(InvalidSetup, match=message):
        Harmonise(**given)


def test_large_shares_are_shares(tmp_path: Path, real: Path, sim: Path) -> None:
    mixed = mix([Part(path=real, share=1e308), Part(path=sim, share=1e308)], tmp_path / "mix", total=6)
    assert mixed.info.origin["mix"]["parts"] == {"real": 3, "sim": 3}
