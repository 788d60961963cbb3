"""Commands that run in the process of the tests, and a dataset that one has made."""

from __future__ import annotations

import io
from collections.abc import Callable
from pathlib import Path

import pytest

from rcs.cli.main import main


@pytest.fixture
def call(capsys: pytest.CaptureFixture[str]) -> Callable[..., tuple[int, str]]:
    """Return a function that runs a command, and returns its exit code and all that it printed."""

    def run(*arguments: object) -> tuple[int, str]:
        with pytest.raises(SystemExit) as stopped:
            main([str(argument) for argument in arguments])
        captured = capsys.readouterr()
        return int(stopped.value.code or 0), captured.out + captured.err

    return run


@pytest.fixture
def call_unwrapped(call: Callable[..., tuple[int, str]]) -> Callable[..., tuple[int, str]]:
    """Return a function like `call`, with all that was printed in one line, wherever it was wrapped."""

    def run(*arguments: object) -> tuple[int, str]:
        code, told = call(*arguments)
        return code, " ".join(told.split())

    return run


class _Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.fixture
def answer(monkeypatch: pytest.MonkeyPatch) -> Callable[[str | None], None]:
    """Return a function that has a person at a terminal type lines; with None, the input is no terminal."""

    def give(lines: str | None) -> None:
        monkeypatch.setattr("sys.stdin", io.StringIO() if lines is None else _Terminal(lines))

    return give


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A dataset of two episodes without cameras."""
    out = tmp_path_factory.mktemp("cli") / "dataset"
    with pytest.raises(SystemExit) as stopped:
        main(["collect", "PickCuboid", "--episodes", "2", "--cameras", "none", "--workers", "1", "--out", str(out)])
    assert stopped.value.code == 0
    return out


@pytest.fixture
def trained(tmp_path: Path) -> Path:
    """A run with the folders of LeRobot: two whole checkpoints, and one that is being written."""
    folder = tmp_path / "act" / "run" / "checkpoints"
    for steps in (1000, 2000, 3000):
        (folder / f"{steps:06d}" / "pretrained_model").mkdir(parents=True)
        (folder / f"{steps:06d}" / "pretrained_model" / "weights").write_text(f"{steps:x}")
    (folder / "last").symlink_to("002000")
    return tmp_path / "act"
