"""Every example and the README's program run as they are."""

from __future__ import annotations

import re
import runpy
from pathlib import Path

import pytest

import rcs
from rcs.devices import lookup
from rcs.rollout.collect import collect
from rcs.rollout.collection import Collection, Progress
from rcs.setups.lab import lab_of

ROOT = Path(__file__).parents[2]
EXAMPLES = sorted((ROOT / "examples").glob("*.py"))
MOST_LINES_IN_README = 12
NEED_EXTRAS = ("07_train_on_it", "10_ppo", "12_planning", "15_calibrate")
DRIVES = {"17_virtual_robot": "franky"}
"""Examples that drive a virtual robot, and the vendor's library that they need."""
SHORT = {
    "10_ppo": ["--steps", "2048", "--unseen", "4"],
    "16_policy": ["--episodes", "2", "--latencies", "0.1"],
}
"""Options with which an example that takes long ends soon."""


def to_run(path: Path) -> object:
    marks = [pytest.mark.extras] * (path.stem in NEED_EXTRAS) + [pytest.mark.hardware] * (path.stem in DRIVES)
    return pytest.param(path, marks=marks, id=path.stem)


@pytest.mark.parametrize("path", [to_run(path) for path in EXAMPLES])
def test_an_example_runs_and_tells_what_it_did(
    path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    if (library := DRIVES.get(path.stem)) is not None:
        pytest.importorskip(library)
    monkeypatch.setenv("EPISODES", "10")  # of the one that clones
    monkeypatch.setattr("sys.argv", [str(path), *SHORT.get(path.stem, [])])
    runpy.run_path(str(path), run_name="__main__")
    assert capsys.readouterr().out.strip()


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_an_example_is_one_straight_script_of_20_to_90_lines(path: Path) -> None:
    assert 20 <= len(path.read_text().splitlines()) <= 90


def test_examples_are_numbered_without_gaps() -> None:
    numbered = sorted((ROOT / "examples").glob("[0-9]*"))  # a package of one's own is a folder
    assert [int(path.name[:2]) for path in numbered] == list(range(len(numbered)))


@pytest.mark.parametrize("robot", [name for name in lookup.names("lab") if len(lab_of(name).stands) == 1])
def test_one_program_runs_on_every_robot_by_changing_one_word(
    robot: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    program = (ROOT / "examples" / "05_any_robot.py").read_text().split("# --- A robot of your own")[0]
    assert program.count('"fr3"') == 1
    path = tmp_path / "program.py"
    path.write_text(program.replace('"fr3"', repr(robot)))
    runpy.run_path(str(path), run_name="__main__")
    assert f"on {robot}: success after" in capsys.readouterr().out


def test_the_first_program_of_the_readme_runs_and_moves_the_arm(tmp_path: Path) -> None:
    program = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)[0]
    assert len(program.strip().splitlines()) <= MOST_LINES_IN_README
    path = tmp_path / "program.py"
    path.write_text(program)
    names = runpy.run_path(str(path))
    assert names["observation"]["tquat"][2] < names["start"]["tquat"][2] - 0.05  # lower than at the start [m]


@pytest.mark.extras
@pytest.mark.gl
def test_the_program_of_the_documents_that_trains_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    section = (ROOT / "docs" / "data.md").read_text().partition("## Train\n")[2]
    program = re.findall(r"```python\n(.*?)```", section, re.DOTALL)[0]
    setup = rcs.Setup(task="PickCuboid", robot="fr3", cameras=("wrist", "side"))
    for _ in collect(Collection(setup=setup, out=tmp_path / "datasets" / "pick", episodes=1), Progress()):
        pass
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "program.py"
    path.write_text(program)
    batch = runpy.run_path(str(path))["batch"]
    promised = re.findall(r"batch(\[.*\])\s+# \((.*?)\)", program)
    assert len(promised) == 4
    for keys, shape in promised:
        found = batch
        for key in re.findall(r"\w+", keys):
            found = found[key]
        assert ", ".join(map(str, found.shape)) == shape
