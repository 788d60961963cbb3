"""The command line as a whole: help, suggestions, completion, and errors."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from rcs_data.cli.program import Table, let_current_folder_be_imported, load, summary

import rcs
from rcs.cli.main import VERBS, main

RCS = [sys.executable, "-c", "from rcs.cli.main import main; main()"]


@pytest.mark.parametrize(
    "words",
    [
        ["eval", "LiftBar", "--episodes", "1", "--workers", "1", "--out", "evaluation"],
        ["collect", "PickCuboid", "--robot", "xarm7", "--episodes", "1", "--workers", "1", "--cameras", "none"],
        ["data", "export", "nowhere", "--format", "lerobot-v3", "--out", "export"],
    ],
)
def test_an_error_at_the_beginning_stands_alone(
    call: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: list[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    code, told = call(*words)
    assert code == 1
    assert told.startswith("error: ")


@pytest.mark.parametrize("command", [["rcs"], [sys.executable, "-m", "rcs"]])
def test_the_version_is_told(command: list[str]) -> None:
    program = [str(Path(sys.executable).with_name("rcs"))] if command == ["rcs"] else command
    told = subprocess.run([*program, "--version"], capture_output=True, text=True, check=True).stdout
    assert told == f"rcs {rcs.__version__}\n"


LIGHT = """
import sys
from rcs.cli.main import VERBS, main
from rcs_data.cli.program import Table, let_current_folder_be_imported, load, summary
try:
    main({arguments!r})
finally:
    print(*sorted(sys.modules), file=sys.stderr)
"""


@pytest.mark.parametrize(
    ("arguments", "heavy"),
    [
        (["--help"], {"mujoco", "tyro", "rich", "rcs._core"}),
        (["--version"], {"mujoco", "tyro", "rich", "rcs._core"}),
        (["data", "--help"], {"mujoco", "tyro", "rich", "pyarrow", "rcs._core"}),
        (["list"], {"mujoco", "tyro", "pyarrow"}),
        (["data", "info", "--help"], {"mujoco"}),
    ],
)
def test_a_command_imports_no_more_than_it_needs(arguments: list[str], heavy: set[str]) -> None:
    program = [sys.executable, "-c", LIGHT.format(arguments=arguments)]
    done = subprocess.run(program, capture_output=True, text=True, check=True)
    assert not heavy & set(done.stderr.split())


def commands(table: Table) -> list[list[str]]:
    found: list[list[str]] = []
    for verb, reference in table.items():
        kind = load(reference)
        found += [[verb, *more] for more in commands(kind)] if isinstance(kind, dict) else [[verb]]
    return found


def test_the_help_of_the_whole_has_a_line_for_every_command(call: Any) -> None:
    for words, table in (([], VERBS), (["data"], load(VERBS["data"]))):
        code, told = call(*words, "--help")
        assert code == 0
        for verb, reference in table.items():
            sentence = summary(reference)
            assert sentence.endswith(".")
            assert f"{verb} {sentence}" in " ".join(told.split())


@pytest.mark.parametrize("words", commands(VERBS), ids=" ".join)
def test_every_command_has_a_help_of_its_own(call: Any, words: list[str]) -> None:
    code, told = call(*words, "--help")
    assert code == 0
    assert f"usage: rcs {' '.join(words)} " in told


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["collct"], ["'collct'", "Did you mean 'collect'"]),
        (["--verison"], ["'--verison'", "Did you mean '--version'"]),
        (["data", "chek", "somewhere"], ["'chek'", "Did you mean 'check'"]),
        (["replay", "somewhere"], ["`rcs data replay`"]),
        (["--print-completion", "bsh"], ["Did you mean 'bash'"]),
        (["collect", "PickCuboid", "--roobt", "fr3"], ["--roobt", "--robot", "rcs collect --help"]),
        (["data", "history", "somewhere", "--jsno"], ["--jsno", "rcs data history --help"]),
    ],
)
def test_what_is_mistyped_gets_a_suggestion(call: Any, arguments: list[str], words: list[str]) -> None:
    code, told = call(*arguments)
    assert code == 2
    for word in words:
        assert word in told
    assert told.count("--help") <= 1, "only the help of this command is named"


@pytest.mark.parametrize("words", [[], ["data"]])
def test_without_a_command_the_help_is_an_error(capsys: pytest.CaptureFixture[str], words: list[str]) -> None:
    with pytest.raises(SystemExit) as stopped:
        main(words)
    captured = capsys.readouterr()
    assert stopped.value.code == 2
    assert captured.out == ""
    assert "COMMAND" in captured.err


def test_bash_completes_commands_and_options_with_the_printed_script(tmp_path: Path) -> None:
    script = subprocess.run([*RCS, "--print-completion", "bash"], capture_output=True, text=True, check=True).stdout
    (tmp_path / "rcs.bash").write_text(script)
    program = """
    source rcs.bash
    complete_line() { COMP_WORDS=("$@"); COMP_CWORD=$(($# - 1)); COMPREPLY=(); _tyro_rcs; echo "${COMPREPLY[*]}"; }
    complete_line rcs da
    complete_line rcs data rena
    complete_line rcs collect --episo
    """
    done = subprocess.run(["bash", "-c", program], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["data", "rename-camera", "--episodes"]


def test_a_class_in_the_current_folder_can_be_imported_where_an_argument_names_one(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (tmp_path / "a_task_of_mine.py").write_text("class Push:\n    '''Push it. Far.'''\n")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", sys.path.copy())
    let_current_folder_be_imported(["mix", "real:143", "--task", "PickCuboid", "sub/folder:x"])
    assert str(tmp_path) not in sys.path
    let_current_folder_be_imported(["collect", "--task=a_task_of_mine:Push"])
    assert sys.path[-1] == str(tmp_path), "last, so that no file takes the place of an installed module"
    assert load("a_task_of_mine:Push").__doc__ == "Push it. Far."
    assert summary("a_task_of_mine:Push") == "Push it."


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["collect", "PickCubiod"], ["PickCubiod", "Did you mean 'PickCuboid'"]),
        (["collect", "PickCuboid", "--robot", "fr4"], ["fr4", "Did you mean 'fr3'"]),
        (["collect", "PickCuboid", "--cameras", "wirst"], ["wirst", "Did you mean 'wrist'"]),
        (["collect", "PickCuboid", "--episodes", "-1"], ["episodes is -1"]),
        (["collect", "PickCuboid", "--workers", "-2"], ["workers is -2"]),
        (["collect", "PickCuboid", "--image-size", "0"], ["image_size"]),
        (["data", "info", "nowhere"], ["nowhere"]),
    ],
)
def test_bad_arguments_get_a_clear_error_and_no_traceback(
    call: Any, tmp_path: Path, arguments: list[str], words: list[str]
) -> None:
    if arguments[0] == "collect":
        arguments = [*arguments, "--out", str(tmp_path / "out")]
    code, told = call(*arguments)
    assert code == 1
    assert "Traceback" not in told
    for word in words:
        assert word in told.replace("\n", " ")
    assert not (tmp_path / "out").exists()


def test_an_output_folder_that_is_a_file_is_refused(call: Any, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("mine")
    code, told = call("collect", "PickCuboid", "--cameras", "none", "--out", str(tmp_path / "file"))
    assert code == 1
    assert "DatasetError" in told
    assert (tmp_path / "file").read_text() == "mine"


@pytest.mark.parametrize(
    "words",
    [
        ["eval", "PickCuboid", "--episodes", "1", "--workers", "1", "--out"],
        ["run", "--policy", "vla://127.0.0.1:1", "--out"],
        ["calibrate", "hand-eye", "--views", "4", "--out"],
        ["calibrate", "intrinsics", "--views", "4", "--out"],
        ["data", "view", "DATASET", "--out"],
    ],
    ids=lambda words: "-".join(word for word in words if word.isalpha() or word.startswith("--")),
)
def test_an_output_that_cannot_be_written_ends_a_command_before_its_work(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, dataset: Path, words: list[str]
) -> None:
    (tmp_path / "file").write_text("mine")
    given = [str(dataset) if word == "DATASET" else word for word in words]
    with pytest.raises(SystemExit) as ended:
        main([*given, str(tmp_path / "file" / "out.mp4")])
    captured = capsys.readouterr()
    assert ended.value.code == 1
    assert captured.out == "", "no work was done"
    assert captured.err.startswith("error: DatasetError: Could not write in")
    assert "Not a directory" in captured.err
    assert [path.name for path in tmp_path.iterdir()] == ["file"]
    assert (tmp_path / "file").read_text() == "mine"
