from __future__ import annotations

from pathlib import Path

import pytest

from rcs.devices import lookup
from rcs.errors import InvalidSetup, UnknownName
from rcs.robots.fr3 import FR3


def test_what_the_project_brings_along_is_found_by_name() -> None:
    assert lookup.find("arm", "fr3") is FR3
    assert {"PickCuboid", "Free"} <= set(lookup.names("task"))
    assert {"realsense_d405", "realsense_d435"} <= set(lookup.names("camera"))


@pytest.mark.parametrize(
    ("kind", "given", "nearest"),
    [
        ("arm", "fr33", "fr3"),
        ("arm", "FR3", "fr3"),
        ("gripper", "franka-hand", "franka_hand"),
        ("camera", "realsense_d415", "realsense_d4"),
        ("task", "pickcuboid", "PickCuboid"),
        ("task", "PickCube", "PickCuboid"),
    ],
)
def test_an_unknown_name_gives_the_nearest_match_and_all_known_ones(
    kind: lookup.Kind, given: str, nearest: str
) -> None:
    with pytest.raises(UnknownName) as caught:
        lookup.find(kind, given)
    text = str(caught.value)
    assert f"Did you mean '{nearest}" in text
    assert all(name in text for name in lookup.names(kind))
    assert "entry-point group 'rcs." in text


def test_a_name_like_no_other_gives_no_match() -> None:
    with pytest.raises(UnknownName) as caught:
        lookup.find("arm", "zzzzzzzz")
    assert "Did you mean" not in str(caught.value)


def test_a_module_suggests_what_is_its_own(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    text = "import numpy as np\nfrom rcs.envs import Task\nclass Knock(Task): ...\nFLAT = Task.Options()\n"
    (tmp_path / "knocking.py").write_text(text)
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(
        UnknownName,
        match=r"no task in the module 'knocking' named 'Knok'\. Did you mean 'Knock'\? Known: FLAT, Knock\.",
    ):
        lookup.find("task", "knocking:Knok")


def test_what_a_package_names_and_cannot_be_imported_is_told_with_the_package(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    about = tmp_path / "torn-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: torn\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text("[rcs.tasks]\nTorn = torn.gone:Task\n")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(InvalidSetup, match=r"The task 'Torn' is 'torn.gone:Task' of the package 'torn'.*No module"):
        lookup.find("task", "Torn")


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (":Arm", "':Arm' is in the module '', which cannot be imported: ValueError"),
        (".lab:Arm", "'.lab:Arm' is in the module '.lab', which cannot be imported: TypeError"),
        ("torn_lab:ARM", "'torn_lab:ARM' is in the module 'torn_lab', which cannot be imported: ZeroDivisionError"),
    ],
)
def test_a_module_that_cannot_be_imported_is_told_whatever_it_raises(
    given: str, words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "torn_lab.py").write_text("ARM = 1 / 0\n")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(InvalidSetup, match=words):
        lookup.find("arm", given)
