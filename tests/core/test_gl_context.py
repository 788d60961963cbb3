"""OpenGL is found where there is some, one backend per process, and else the remedy is told."""

from __future__ import annotations

import os
import subprocess
import sys
import textwrap
from pathlib import Path

import mujoco
import pytest

from rcs import _core


def run(program: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run a program in a fresh process, where no backend is chosen yet."""
    return subprocess.run(
        [sys.executable, "-c", textwrap.dedent(program)],
        env={**os.environ, **environment, "PYTHONPATH": os.pathsep.join(sys.path)},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )


def test_the_probe_says_of_every_backend_what_it_is_or_what_to_install() -> None:
    probes = _core.probe_gl()
    assert [probe.name for probe in probes] == ["egl", "osmesa"]
    for probe in probes:
        assert ("OpenGL" if probe.ok else "apt-get install") in probe.detail


@pytest.mark.gl
@pytest.mark.parametrize("backend", ["egl", "osmesa"])
def test_every_backend_that_the_probe_calls_good_draws(backend: str) -> None:
    probe = next(probe for probe in _core.probe_gl() if probe.name == backend)
    if not probe.ok:
        pytest.skip(probe.detail)
    program = f"""
        import mujoco, numpy as np
        from rcs import _core
        model = mujoco.MjModel.from_xml_string(
            "<mujoco><worldbody><geom size='.1'/><camera pos='0 0 1'/></worldbody></mujoco>"
        )
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        pool = _core.RenderPool(model, 2, backend={backend!r})
        state = np.zeros((4, pool.state_size))
        mujoco.mj_getState(model, data, state[0], int(mujoco.mjtState.mjSTATE_INTEGRATION))
        state[:] = state[0]
        rgb = np.zeros((4, 64, 64, 3), np.uint8)
        pool.render_states(state, [0], [rgb])
        print(pool.description.split(":")[0], [int(picture[32, 32].min()) > 100 for picture in rgb])
    """
    answer = run(program)
    assert answer.stdout.strip() == f"{backend} [True, True, True, True]", answer.stderr


@pytest.mark.gl
def test_a_second_backend_in_one_process_is_refused() -> None:
    model = mujoco.MjModel.from_xml_string("<mujoco/>")
    first = _core.Renderer(model)
    used = first.description.split(":")[0]
    with pytest.raises(ValueError, match="one per process"):
        _core.Renderer(model, backend="osmesa" if used == "egl" else "egl")
    first.close()


@pytest.mark.gl
@pytest.mark.parametrize("backend", ["egl", "osmesa"])
def test_it_draws_next_to_the_renderer_of_mujoco(backend: str) -> None:
    probe = next(probe for probe in _core.probe_gl() if probe.name == backend)
    if not probe.ok:
        pytest.skip(probe.detail)
    program = """
        import mujoco, numpy as np
        from rcs import _core
        model = mujoco.MjModel.from_xml_string(
            "<mujoco><worldbody><geom size='.1' rgba='1 0 0 1'/><camera pos='0 0 1'/></worldbody></mujoco>"
        )
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        rgb = np.zeros((64, 64, 3), np.uint8)
        with mujoco.Renderer(model, 64, 64) as theirs:
            ours = _core.Renderer(model)
            for _ in range(2):
                theirs.update_scene(data, 0)
                ours.update(data)
                ours.render(0, rgb)
                print(abs(theirs.render().astype(int) - rgb)[32, 32].max() < 8)
    """
    answer = run(program, MUJOCO_GL=backend)
    assert answer.stdout.split() == ["True", "True"], answer.stderr
    assert answer.returncode == 0, answer.stderr  # MuJoCo ends the display at exit, before ours is closed


def test_without_opengl_the_error_has_the_remedy_for_each_backend(tmp_path: Path) -> None:
    for name in ("libEGL.so.1", "libOSMesa.so.8", "libOSMesa.so.6"):
        (tmp_path / name).write_bytes(b"\0" * 4096)  # found first, and no library
    program = """
        import mujoco
        from rcs import _core
        from rcs.errors import MissingDependency
        assert not any(probe.ok for probe in _core.probe_gl())
        model = mujoco.MjModel.from_xml_string("<mujoco/>")
        try:
            _core.Renderer(model)
        except MissingDependency as error:
            print(error)
    """
    answer = run(program, LD_LIBRARY_PATH=str(tmp_path))
    assert "apt-get install libegl1" in answer.stdout, answer.stderr
    assert "apt-get install libosmesa6" in answer.stdout
