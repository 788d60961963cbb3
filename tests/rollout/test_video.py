"""Videos: a picture per reset and step, at the speed of the environment, and nothing to install.

Those of episodes that cannot be run again are what their recording has.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import av
import gymnasium
import numpy as np
import pytest
from numpy.typing import NDArray
from rcs_data import DatasetInfo, DatasetWriter, Feature
from rcs_data.ledger import Condition, Ledger, Row
from rcs_data.ledger.condition import key_of

import rcs
from rcs.errors import InvalidSetup
from rcs.rollout.video import Film, Video, cut_films, new_film

CONDITION = Condition(agent="act", task="Pick", robot="fr3", setup={}, platform={"fr3": "franka"})
CAMERA = Feature(key="observation/frames/side/rgb", shape=(32, 48, 3), dtype="uint8", encoding="lossless")


def pictures(path: Path) -> list[NDArray[np.uint8]]:
    with av.open(str(path)) as container:
        return [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]


def test_pictures_come_back_in_their_order_colour_and_rate(tmp_path: Path) -> None:
    video = Video(tmp_path / "new" / "v.mp4", rate=12.5)
    shades = (20, 120, 220)
    for shade in shades:
        video.add(np.full((49, 65, 3), shade, np.uint8))
    video.close()
    video.close()
    seen = pictures(tmp_path / "new" / "v.mp4")
    assert [picture.shape for picture in seen] == [(48, 64, 3)] * 3, "an odd edge loses a pixel"
    np.testing.assert_allclose([picture.mean() for picture in seen], shades, atol=4)
    with av.open(str(tmp_path / "new" / "v.mp4")) as container:
        assert container.streams.video[0].average_rate == 12.5


def test_without_a_picture_there_is_no_file(tmp_path: Path) -> None:
    Video(tmp_path / "v.mp4", rate=30.0).close()
    assert not list(tmp_path.iterdir())


def test_a_new_film_is_there_whole_or_not_at_all(tmp_path: Path) -> None:
    path = tmp_path / "f.mp4"
    (tmp_path / ".f.mp4").write_bytes(b"left by a kill")
    with new_film(path):
        pass
    assert not list(tmp_path.iterdir()), "there was no picture"
    with new_film(path) as draft, closing(Video(draft, rate=30.0)) as video:
        video.add(np.zeros((48, 64, 3), np.uint8))
        assert not path.exists()
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.gl
def test_a_film_has_a_picture_per_reset_and_step_and_ends_with_its_block(tmp_path: Path) -> None:
    env = rcs.make("PickCuboid", frequency=20.0)
    with closing(Film(env, size=(64, 48))) as film, film.into(tmp_path / "f.mp4"):
        env.reset(seed=0)
        for _ in range(5):
            env.step(env.action_space.sample())
        env.reset(seed=1)
    env.step(env.action_space.sample())
    seen = pictures(tmp_path / "f.mp4")
    assert len(seen) == 7
    assert seen[0].shape == (48, 64, 3)
    env.close()


@pytest.mark.gl
def test_gymnasiums_own_recordings_become_a_video(tmp_path: Path) -> None:
    env = gymnasium.wrappers.RenderCollection(rcs.make("PickCuboid", render_mode="rgb_array"))
    env.reset(seed=0)
    for _ in range(3):
        env.step(env.action_space.sample())
    video = Video(tmp_path / "v.mp4", rate=30.0)
    for picture in env.render():
        video.add(picture)
    video.close()
    assert len(pictures(tmp_path / "v.mp4")) == 4
    env.close()


IN_A_WINDOW = """
import rcs
env = rcs.make("PickCuboid", render_mode="human")
env.reset(seed=0)
for _ in range(3):
    env.step(env.action_space.sample())
assert env.render() is None
env.close()
print("shown")
"""


@pytest.mark.gl
@pytest.mark.skipif(shutil.which("xvfb-run") is None, reason="there is no xvfb-run, which makes a display")
def test_where_there_is_a_display_the_human_mode_opens_a_window_and_closes_it() -> None:
    command = ["xvfb-run", "-a", sys.executable, "-c", IN_A_WINDOW]
    done = subprocess.run(command, capture_output=True, text=True, timeout=90, check=False)
    assert (done.returncode, done.stdout.strip()) == (0, "shown"), done.stderr


def test_real_devices_alone_cannot_be_filmed(tmp_path: Path) -> None:
    with (
        pytest.raises(InvalidSetup, match="no picture to film"),
        Film(rcs.make("Free", hardware="fake")).into(tmp_path),
    ):
        pass


def test_a_relative_path_that_looks_like_an_address_is_a_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    video = Video("12:30/a.mp4", rate=10)
    video.add(np.zeros((16, 16, 3), np.uint8))
    video.close()
    assert (tmp_path / "12:30" / "a.mp4").is_file()


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
    seen = pictures(ledger.film(rows[2]))
    assert len(seen) == 5
    assert abs(float(np.mean(seen)) - 200) < 4, "the kill has left the other one"
    assert cut_films(tmp_path / "data", ledger, CONDITION.hash, 2) == []


def test_a_recording_without_colour_is_refused(ledger: Ledger, tmp_path: Path) -> None:
    joints = Feature(key="observation/joints", shape=(7,), dtype="float64")
    with DatasetWriter.open(
        tmp_path / "data", DatasetInfo(frequency=30.0, features=(joints,), setup={}, instruction="")
    ):
        pass
    with pytest.raises(InvalidSetup, match="no colour camera"):
        cut_films(tmp_path / "data", ledger, CONDITION.hash, 2)
