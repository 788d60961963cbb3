"""Environments of policies, made once by their own recipes, and servers in them."""

from __future__ import annotations

import contextlib
import hashlib
import os
import shutil
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from vlagents.policies import catalogue

PROJECT = Path(__file__).parents[3]
PACKAGE = PROJECT / "packages" / "vlagents"
ENVIRONMENTS = Path(os.environ.get("VLAGENTS_ENVIRONMENTS", PROJECT / "build" / "interop"))
"""Where environments are kept between runs."""
QUIET = {
    "HF_HUB_OFFLINE": "1",
    "TF_CPP_MIN_LOG_LEVEL": "2",
    "CUDA_VISIBLE_DEVICES": "",
    "TOKENIZERS_PARALLELISM": "false",
    "OMP_NUM_THREADS": "1",
}


class Environment:
    """A family's virtual environment."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def run(self, *words: str | Path, status: int = 0) -> str:
        """Run a program of the environment; return what it printed, and fail if it ends with another status."""
        command = [self.folder / "bin" / str(words[0]), *words[1:]]
        done = subprocess.run(command, env=os.environ | QUIET, capture_output=True, text=True, timeout=600, check=False)
        assert done.returncode == status, f"{command} ended with {done.returncode}:\n{done.stdout}\n{done.stderr}"
        return done.stdout + done.stderr

    def install_vlagents(self) -> None:
        """Install this tree's vlagents, whenever the environment was made."""
        self.run("python", "-m", "pip", "-q", "install", "--no-deps", "-e", PACKAGE)

    @contextlib.contextmanager
    def serve(self, name: str, checkpoint: Path, *words: str | Path, program: Path | None = None) -> Iterator[str]:
        """Serve a policy by `vlagents serve`, or by a program that takes the same words; yield its address."""
        start = [self.folder / "bin" / "vlagents"] if program is None else [self.folder / "bin" / "python", program]
        command = [*start, "serve", name, "--checkpoint", checkpoint, "--port", "0", *words]
        with (checkpoint.parent / "served.log").open("w+") as log:
            serving = subprocess.Popen(command, env=os.environ | QUIET, stdout=subprocess.PIPE, stderr=log, text=True)
            try:
                assert serving.stdout is not None
                for line in serving.stdout:  # some stacks print before
                    if " at " in line and line.startswith("Serving "):
                        break
                else:
                    log.seek(0)
                    pytest.fail(f"{name} was not served:\n{log.read()[-4000:]}")
                yield line.split(" at ")[1].split(". ")[0]
            finally:
                serving.terminate()
                serving.wait(30)
                serving.stdout.close()


@pytest.fixture(scope="session")
def environment() -> Callable[..., Environment]:
    """Return a function that makes a family's environment by its recipe, or takes one that was made by the same recipe.

    It skips the test if a checkout that the recipe needs is not named by its variable.
    """

    def made(family: str, *needed: str) -> Environment:
        for name in needed:
            if not Path(os.environ.get(name, "/nowhere")).is_dir():
                pytest.skip(f"{name} names no folder; `vlagents recipe {family}` says which checkout belongs there")
        folder = ENVIRONMENTS / f"vlagents-{family}"
        script = catalogue.recipe(family)
        stamp, wanted = folder / "recipe.sha256", hashlib.sha256(script.encode()).hexdigest()
        if not stamp.is_file() or stamp.read_text() != wanted:
            shutil.rmtree(folder, ignore_errors=True)
            folder.parent.mkdir(parents=True, exist_ok=True)
            variables = os.environ | {"VLAGENTS": str(PACKAGE)}
            words = ["sh", "-s", "--", str(folder)]
            done = subprocess.run(words, input=script, env=variables, capture_output=True, text=True, check=False)
            assert done.returncode == 0, f"the recipe of {family} failed:\n{done.stdout[-4000:]}\n{done.stderr[-4000:]}"
            stamp.write_text(wanted)
        environment = Environment(folder)
        environment.install_vlagents()
        return environment

    return made


@pytest.fixture(scope="session")
def made_by_make() -> Callable[[str], Environment]:
    """Return a function that takes an environment which `make test-interop` makes, and skips the test without it."""

    def found(name: str) -> Environment:
        environment = Environment(ENVIRONMENTS / name)
        if not (environment.folder / "bin" / "python").is_file():
            pytest.skip(f"there is no {environment.folder}; `make test-interop` makes it")
        return environment

    return found
