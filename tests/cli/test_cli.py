"""The command line: what it prints, what it leaves on disk, and its exit codes."""

from __future__ import annotations

import importlib.metadata
import os
import re
import resource
import signal
import subprocess
import sys
import time
import tomllib
from pathlib import Path

import pytest
from rcs_data import Dataset
from rcs_data.cli.verbs import Table, let_current_folder_be_imported, load, summary

import rcs
from rcs.cli.doctor import missing
from rcs.cli.main import VERBS, main
from rcs.setups.ids import ids
from rcs.setups.lab import lab_of

ROOT = Path(__file__).parents[2]
HOME = (0.0, -0.7854, 0.0, -2.3562, 0.0, 1.5708, 0.7854)
RCS = [sys.executable, "-c", "from rcs.cli.main import main; main()"]


def call(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str]:
    with pytest.raises(SystemExit) as stopped:
        main(list(arguments))
    captured = capsys.readouterr()
    return int(stopped.value.code or 0), captured.out + captured.err


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("cli") / "dataset"
    with pytest.raises(SystemExit) as stopped:
        main(["collect", "PickCuboid", "--episodes", "2", "--cameras", "none", "--workers", "1", "--out", str(out)])
    assert stopped.value.code == 0
    return out


def test_collect_leaves_a_dataset_and_a_report(dataset: Path) -> None:
    assert len(Dataset.open(dataset)) == 2
    assert "<html" in (dataset / "report.html").read_text()


def test_collect_again_finds_everything_there(capsys: pytest.CaptureFixture[str], dataset: Path) -> None:
    code, told = call(
        capsys, "collect", "PickCuboid", "--episodes", "2", "--cameras", "none", "--workers", "1", "--out", str(dataset)
    )
    assert code == 0
    assert "Nothing to do" in told


def test_of_more_episodes_than_were_asked_for_the_bar_is_full(
    capsys: pytest.CaptureFixture[str], dataset: Path
) -> None:
    code, told = call(capsys, "collect", "PickCuboid", "--episodes", "1", "--cameras", "none", "--out", str(dataset))
    assert code == 0
    assert "1/1" in told
    assert "2/1" not in told


@pytest.mark.parametrize(
    "words",
    [
        ["eval", "LiftBar", "--episodes", "1", "--workers", "1", "--out", "evaluation"],
        ["collect", "PickCuboid", "--robot", "xarm7", "--episodes", "1", "--workers", "1", "--cameras", "none"],
        ["data", "export", "nowhere", "--format", "lerobot-v3", "--out", "export"],
    ],
)
def test_an_error_at_the_beginning_stands_alone(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: list[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    code, told = call(capsys, *words)
    assert code == 1
    assert told.startswith("error: ")


def test_randomised_episodes_are_collected_and_replayed(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    options = ["--episodes", "2", "--cameras", "none", "--workers", "1", "--out", str(tmp_path / "varied")]
    assert call(capsys, "collect", "PickCuboid", "--randomisation", "default", *options)[0] == 0
    assert "object_mass" in Dataset.open(tmp_path / "varied").episodes[0].outcome["randomisation"]
    assert call(capsys, "data", "replay", str(tmp_path / "varied"))[0] == 0


def test_info_tells_episodes_success_and_features(capsys: pytest.CaptureFixture[str], dataset: Path) -> None:
    code, told = call(capsys, "data", "info", str(dataset))
    assert code == 0
    for word in ("pick up the green cuboid", "Wilson", "observation/joints", "sha256"):
        assert word in told


def test_check_and_recover_are_content_with_a_good_dataset(capsys: pytest.CaptureFixture[str], dataset: Path) -> None:
    assert call(capsys, "data", "check", str(dataset))[0] == 0
    assert call(capsys, "data", "recover", str(dataset))[0] == 0


def test_replay_finds_all_states_equal(capsys: pytest.CaptureFixture[str], dataset: Path) -> None:
    code, told = call(capsys, "data", "replay", str(dataset))
    assert code == 0
    assert "2 of 2 episodes bit-equal" in told


def test_check_finds_a_flipped_bit_and_fails(capsys: pytest.CaptureFixture[str], dataset: Path, tmp_path: Path) -> None:
    import shutil

    copy = tmp_path / "copy"
    shutil.copytree(dataset, copy)
    steps = copy / "episodes" / "000001" / "steps.parquet"
    content = bytearray(steps.read_bytes())
    content[len(content) // 2] ^= 1
    steps.write_bytes(content)
    code, told = call(capsys, "data", "check", str(copy))
    assert code == 1
    assert "000001" in told
    assert "000000" not in told


def test_collect_records_the_frames_of_tactile_sensors(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    out = str(tmp_path / "touch")
    options = ("--robot", "so101", "--cameras", "none", "--tactile", "digit", "--episodes", "1", "--workers", "1")
    code, _ = call(capsys, "collect", "PickCuboid", *options, "--no-report", "--out", out)
    assert code == 0
    assert "observation/frames/so101_left/rgb" in (tmp_path / "touch" / "dataset.json").read_text()


PAIRS = [(task, robot) for task, robot in ids().values() if task != "Free"]


@pytest.mark.gl
@pytest.mark.parametrize(("task", "robot"), PAIRS)
def test_every_task_is_collected_with_the_cameras_of_its_robots_lab(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, task: str, robot: str
) -> None:
    options = ("--robot", robot, "--episodes", "1", "--workers", "1", "--image-size", "32")
    code, told = call(capsys, "collect", task, *options, "--out", str(tmp_path / "set"))
    assert code == 0, told
    dataset = Dataset.open(tmp_path / "set")
    assert dataset.info.setup["cameras"]["names"] == list(lab_of(robot).cameras)
    assert dataset.episodes[0].success


@pytest.mark.parametrize("command", [["rcs"], [sys.executable, "-m", "rcs"]])
def test_the_version_is_told(command: list[str]) -> None:
    program = [str(Path(sys.executable).with_name("rcs"))] if command == ["rcs"] else command
    told = subprocess.run([*program, "--version"], capture_output=True, text=True, check=True).stdout
    assert told == f"rcs {rcs.__version__}\n"


LIGHT = """
import sys
from rcs.cli.main import VERBS, main
from rcs_data.cli.verbs import Table, let_current_folder_be_imported, load, summary
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


def test_the_help_of_the_whole_has_a_line_for_every_command(capsys: pytest.CaptureFixture[str]) -> None:
    for words, table in (([], VERBS), (["data"], load(VERBS["data"]))):
        code, told = call(capsys, *words, "--help")
        assert code == 0
        for verb, reference in table.items():
            sentence = summary(reference)
            assert sentence.endswith(".")
            assert f"{verb} {sentence}" in " ".join(told.split())


@pytest.mark.parametrize("words", commands(VERBS), ids=" ".join)
def test_every_command_has_a_help_of_its_own(capsys: pytest.CaptureFixture[str], words: list[str]) -> None:
    code, told = call(capsys, *words, "--help")
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
def test_what_is_mistyped_gets_a_suggestion(
    capsys: pytest.CaptureFixture[str], arguments: list[str], words: list[str]
) -> None:
    code, told = call(capsys, *arguments)
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


def test_list_names_robots_cameras_tasks_and_ids(capsys: pytest.CaptureFixture[str]) -> None:
    code, told = call(capsys, "list")
    assert code == 0
    for word in ("fr3", "franka_hand", "realsense_d405", "realsense_d435", "PickCuboid", "rcs/FR3-v0"):
        assert word in told
    assert "DIGIT, on the pads of franka_hand, robotiq_2f85, so101_gripper" in " ".join(told.split())


def test_list_names_the_modes_of_every_camera(capsys: pytest.CaptureFixture[str]) -> None:
    code, told = call(capsys, "list", "--cameras")
    assert code == 0
    rows = [line.split() for line in told.splitlines()]
    assert ["realsense_d435", "640x480", "6,", "15,", "30,", "60", "617.2", "0.175", "..", "3"] in rows
    assert ["usb_webcam", "640x480", "5,", "10,", "15,", "20,", "25,", "~30", "609.3", "-"] in rows


def test_list_names_what_is_broken_in_a_package_and_goes_on(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    about = tmp_path / "torn_robot-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: torn-robot\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text(
        "[rcs.arms]\ngone = torn_robot.gone:ARM\nfails = torn_robot.fails:ARM\nother = torn_robot:A_TEXT\n"
        "[rcs.cameras]\ngone_camera = torn_robot.gone:CAMERA\n"
        "[rcs.tasks]\nNoClass = torn_robot:NoClass\nNoSyntax = torn_robot.fails:Task\nFine = torn_robot:Fine\n"
    )
    package = tmp_path / "torn_robot"
    package.mkdir()
    (package / "__init__.py").write_text("A_TEXT = 'no arm'\nclass Fine:\n    'Do well.'\n")
    (package / "fails.py").write_text("class Task\n")
    monkeypatch.syspath_prepend(tmp_path)
    code, told = call(capsys, "list")
    assert code == 0, told
    words = " ".join(told.split())
    for name, reason in (
        ("arm gone", "ModuleNotFoundError: No module named 'torn_robot.gone'"),
        ("arm fails", "SyntaxError: expected ':'"),
        ("arm other", "AttributeError: 'str' object has no attribute 'label'"),
        ("camera gone_camera", "ModuleNotFoundError"),
        ("task NoClass", "AttributeError: module 'torn_robot' has no attribute 'NoClass'"),
        ("task NoSyntax", "SyntaxError: expected ':'"),
    ):
        assert f"{name} broken: torn_robot" in words
        assert f"of the package torn-robot: {reason}" in words
    assert "task Fine Do well." in words
    assert "arm fr3 Franka Research 3" in words
    code, told = call(capsys, "list", "--cameras")
    assert code == 0
    assert "gone_camera broken; see `rcs list`" in " ".join(told.split())
    assert "realsense_d435" in told


def test_doctor_tells_which_backend_draws_and_why_and_all_extras(capsys: pytest.CaptureFixture[str]) -> None:
    code, told = call(capsys, "doctor")
    assert "GL egl" in told
    assert "GL osmesa" in told
    assert (code == 0) == ("chosen" in told)
    for extra in importlib.metadata.metadata("robot-control-stack").get_all("Provides-Extra") or ():
        assert f"extra {extra}" in told


def test_doctor_looks_into_the_extras_of_packages(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    parts = tomllib.loads((ROOT / "packages/rcs-data/pyproject.toml").read_text())["project"]["optional-dependencies"]
    monkeypatch.setenv("COLUMNS", "200")
    told = [line.split() for line in call(capsys, "doctor")[1].splitlines()]
    for extra in ("hdf5", "mcap", "hub", "rerun"):
        (package,) = (re.split("[>=<]", line)[0] for line in parts[extra])
        is_there = bool(list(importlib.metadata.Distribution.discover(name=package)))
        (words,) = (line[2:] for line in told if line[:2] == ["extra", extra])
        assert words[:3] == (["installed"] if is_there else ["not", "installed", f"({package}):"])


def test_what_an_extra_lacks_is_found_behind_other_extras(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    needs = {
        "whole": ['part[deep,here]>=2; extra == "all"', 'other; python_version < "3" and extra == "all"'],
        "part": ["missing-one>=1 ; extra == 'deep'", "whole; extra == 'here'", "missing-two; extra == 'unasked'"],
    }
    for name, lines in needs.items():
        folder = tmp_path / f"{name}-2.0.dist-info"
        folder.mkdir()
        described = "".join(f"Requires-Dist: {line}\n" for line in lines)
        (folder / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 2.0\n{described}")
    monkeypatch.syspath_prepend(str(tmp_path))
    assert missing("whole", "all") == ["missing-one"]
    assert missing("part", "here") == []


def test_a_missing_gl_library_is_told_with_its_remedy(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    from rcs.cli import doctor

    class Probe:
        def __init__(self, name: str, detail: str) -> None:
            self.name, self.ok, self.detail = name, False, detail

    monkeypatch.setattr(
        doctor, "probe_gl", lambda: [Probe("egl", "no libEGL.so.1"), Probe("osmesa", "apt-get install libosmesa6")]
    )
    code, told = call(capsys, "doctor")
    assert code == 1
    assert "apt-get install libosmesa6" in told


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
    capsys: pytest.CaptureFixture[str], tmp_path: Path, arguments: list[str], words: list[str]
) -> None:
    if arguments[0] == "collect":
        arguments = [*arguments, "--out", str(tmp_path / "out")]
    code, told = call(capsys, *arguments)
    assert code == 1
    assert "Traceback" not in told
    for word in words:
        assert word in told.replace("\n", " ")
    assert not (tmp_path / "out").exists()


def test_an_output_folder_that_is_a_file_is_refused(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    (tmp_path / "file").write_text("mine")
    code, told = call(capsys, "collect", "PickCuboid", "--cameras", "none", "--out", str(tmp_path / "file"))
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
        ["plan", "PickCuboid", "--goal", *map(str, HOME), "--out"],
        ["gallery", "--out"],
        ["ik", "fr3", "--pose", "0.4", "0", "0.3", "3.1416", "0", "0", "--picture"],
        ["data", "sample", "DATASET", "--out"],
        ["data", "sample", "DATASET", "--png"],
        ["data", "view", "DATASET", "--out"],
        ["data", "view", "DATASET", "--rerun"],
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


def start(out: Path, *arguments: str, limit: int | None = None) -> subprocess.Popen[str]:
    def set_limit() -> None:
        if limit is not None:
            resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
            signal.signal(signal.SIGXFSZ, signal.SIG_IGN)

    command = [*RCS, "collect", "PickCuboid", "--cameras", "none", "--out", str(out), *arguments]
    return subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
        preexec_fn=set_limit,
    )


def wait_for_episodes(out: Path, count: int) -> None:
    deadline = time.monotonic() + 30
    while len(list((out / "episodes").glob("0*/episode.json"))) < count:
        assert time.monotonic() < deadline, "no episodes within 30 s"
        time.sleep(0.02)


def test_a_disk_without_room_ends_the_collection_with_a_clear_error(tmp_path: Path) -> None:
    # A limit on the size of files stands in for a full disk: writes fail the same way.
    process = start(tmp_path / "out", "--episodes", "2", "--workers", "1", limit=20_000)
    told, _ = process.communicate(timeout=60)
    assert process.returncode == 1
    assert "DatasetError" in told
    assert "Traceback" not in told


@pytest.mark.skipif(os.name != "posix", reason="signals are POSIX's")
@pytest.mark.parametrize("workers", ["1", "2"])
def test_ctrl_c_finishes_cleanly_and_the_same_command_goes_on(tmp_path: Path, workers: str) -> None:
    out = tmp_path / "out"
    process = start(out, "--episodes", "500", "--workers", workers)
    wait_for_episodes(out, 2)
    os.killpg(process.pid, signal.SIGINT)
    told, _ = process.communicate(timeout=60)
    assert process.returncode == 130, told
    kept = len(Dataset.open(out))
    assert 2 <= kept < 500
    assert not list((out / "episodes").glob(".*")), "nothing is left open"
    assert (out / "report.html").exists()
    again = start(out, "--episodes", str(kept + 1), "--workers", "1")
    told, _ = again.communicate(timeout=60)
    assert again.returncode == 0, told
    assert len(Dataset.open(out)) == kept + 1


def is_worker(pid: str) -> bool:
    """Return whether a process is a worker; one that has ended since it was listed is none."""
    try:
        return b"spawn_main" in Path(f"/proc/{pid}/cmdline").read_bytes()
    except (FileNotFoundError, ProcessLookupError):
        return False


def workers_of(pid: int) -> list[int]:
    """Return the worker processes of a process, from when they are started on."""
    children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    return [int(child) for child in children if is_worker(child)]


@pytest.mark.skipif(sys.platform != "linux", reason="workers are found in /proc")
@pytest.mark.slow
@pytest.mark.parametrize(("verb", "after"), [("collect", 0.0), ("eval", 0.3)])
def test_ctrl_c_while_workers_start_ends_as_at_any_other_time(tmp_path: Path, verb: str, after: float) -> None:
    options = ["--cameras", "none", "--episodes", "500", "--workers", "2", "--out", str(tmp_path / "out")]
    process = subprocess.Popen(
        [*RCS, verb, "PickCuboid", *options],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
    )
    deadline = time.monotonic() + 60.0
    while not workers_of(process.pid) and process.poll() is None and time.monotonic() < deadline:
        time.sleep(0.002)
    time.sleep(after)
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does, to workers too
    told, _ = process.communicate(timeout=60)
    assert process.returncode == 130, told
    assert "Ending after the episodes at work" in told
    assert "Traceback" not in told


def test_ctrl_c_while_a_command_is_imported_ends_without_a_word(tmp_path: Path) -> None:
    # Extensions that are interrupted while they start raise an ImportError.
    (tmp_path / "slow_verb.py").write_text(
        "import time\n"
        "print('importing', flush=True)\n"
        "try:\n    time.sleep(60.0)\nexcept KeyboardInterrupt as err:\n    raise ImportError('failed') from err\n"
    )
    program = "from rcs_data.cli.program import Program; Program('rcs', {'slow': 'slow_verb:Slow'}, '1').main(['slow'])"
    process = subprocess.Popen(
        [sys.executable, "-c", program], cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "importing\n"
    process.send_signal(signal.SIGINT)
    told, complaint = process.communicate(timeout=60)
    assert (process.returncode, told, complaint) == (130, "", "")


@pytest.mark.parametrize("words", [["--help"], ["collect", "--help"], ["--version"], ["list"]])
def test_a_reader_that_goes_away_ends_the_command_quietly(words: list[str]) -> None:
    command = [*RCS, *words]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None and process.stderr is not None
        process.stdout.close()
        assert process.stderr.read() == ""
    assert process.returncode == 1
