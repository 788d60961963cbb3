"""Import does nothing: no network, no file but modules and lists of names, no variable, no plugin, no GL."""

from __future__ import annotations

import json
import site
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest
import rcs_data

import rcs

WATCHED = """
import json, os, sys
import encodings.idna, site  # what any program has

opened, connected, asked, found = [], [], [], []
MODULES = (".py", ".pyi", ".pyc", ".so", ".pth", ".zip", "entry_points.txt")

def watch(event, arguments):
    if event == "open" and not str(arguments[0]).endswith(MODULES):
        opened.append(str(arguments[0]))
    if event.startswith("socket."):
        connected.append(event)
    if event in ("subprocess.Popen", "os.system", "glob.glob"):
        found.append(event)

class Environment(type(os.environ)):
    def __getitem__(self, key):
        frame = sys._getframe(1)
        while frame.f_globals["__name__"] in ("os", "collections.abc"):
            frame = frame.f_back
        asked.append([frame.f_globals["__name__"], key])
        return super().__getitem__(key)

os.environ.__class__ = Environment
{before}
already = set(sys.modules)
sys.addaudithook(watch)
import rcs
{after}
modules = sorted(set(sys.modules) - already)
print(json.dumps(dict(opened=opened, connected=connected, asked=asked, found=found, modules=modules)))
"""


def watch(*options: str, before: str = "", after: str = "") -> dict[str, Any]:
    program = WATCHED.format(before=before, after=after)
    done = subprocess.run(
        [sys.executable, *options, "-c", program], capture_output=True, text=True, check=False, timeout=60
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def roots(modules: list[str]) -> set[str]:
    return {name.partition(".")[0] for name in modules}


def test_importing_the_package_has_no_effect() -> None:
    # No site module: an editable install has an import hook of its own.
    paths = [*(str(Path(str(module.__file__)).parents[1]) for module in (rcs, rcs_data)), *site.getsitepackages()]
    seen = watch("-I", "-S", "-B", before=f"sys.path += {paths!r}")
    assert seen["opened"] == []
    assert seen["connected"] == []
    assert seen["found"] == []
    # NumPy, which gymnasium imports, asks for its own.
    assert [key for module, key in seen["asked"] if not module.startswith("numpy")] == []
    assert not roots(seen["modules"]) & {"OpenGL", "mujoco", "pyarrow", "av", "torch", "tyro", "rich"}
    assert "rcs._core" not in seen["modules"]


def test_making_and_stepping_an_environment_needs_no_gl_and_no_network() -> None:
    seen = watch(after='env = rcs.make("PickCuboid"); env.reset(seed=0); env.step(env.action_space.sample())')
    assert seen["connected"] == []
    assert not roots(seen["modules"]) & {"OpenGL", "torch", "pyarrow", "av", "tyro", "ray"}


def test_public_names_are_listed_and_others_are_refused_with_them() -> None:
    assert {"make", "make_vec", "Setup", "Pose"} <= set(dir(rcs))
    with pytest.raises(AttributeError, match="Did you mean 'make_vec'"):
        _ = rcs.make_vecs


SCRIPT = """
import pickle
import cloudpickle
import gymnasium
import rcs, rcs_data

def env():
    return gymnasium.wrappers.FlattenObservation(rcs.make("PickCuboid", max_episode_steps=2))

def names():
    return rcs.Pose.__name__, rcs_data.Dataset.__name__, rcs.envs.Layer.__name__

if __name__ == "__main__":
    assert pickle.loads(cloudpickle.dumps(names))() == ("Pose", "Dataset", "Layer")
    if {has_processes}:
        envs = gymnasium.vector.AsyncVectorEnv([env, env], context="spawn", shared_memory=False)
        envs.reset(seed=0)
        envs.step(envs.action_space.sample())
        envs.close()
    print("done")
"""


@pytest.mark.parametrize("has_processes", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_functions_of_a_script_that_use_the_packages_can_be_sent_to_other_processes(
    tmp_path: Path, has_processes: bool
) -> None:
    script = tmp_path / "script.py"
    script.write_text(SCRIPT.format(has_processes=has_processes))
    done = subprocess.run([sys.executable, script], capture_output=True, text=True, check=False, timeout=60)
    assert (done.returncode, done.stdout) == (0, "done\n"), done.stderr


def test_all_places_tell_the_same_version() -> None:
    root = Path(__file__).parents[1]
    version = tomllib.loads((root / "pyproject.toml").read_text())["project"]["version"]
    assert rcs.__version__ == version
    assert f"\nversion: {version}\n" in (root / "CITATION.cff").read_text()
    assert f"\n## {version}" in (root / "CHANGELOG.md").read_text()
