"""A pool draws many states on its own threads, and each picture is that of a single renderer."""

from __future__ import annotations

import gc
import subprocess
import weakref
from collections.abc import Callable

import mujoco
import numpy as np
import pytest

from rcs import _core
from rcs.errors import WrongOrder
from rcs.sim import World
from rcs.sim.world import Callback
from tests.core.drawn_scene import SCENE, Depth, Image, MakeRenderer, build, draw, state_of

RunProgram = Callable[..., subprocess.CompletedProcess[str]]


@pytest.mark.gl
@pytest.mark.parametrize("threads", [1, 2, 3])
def test_a_pool_draws_the_pictures_of_a_single_renderer(make: MakeRenderer, threads: int) -> None:
    model, data = build()
    renderer = make(model)
    cameras = [model.camera("side").id, model.camera("top").id]
    sizes = [(60, 80), (132, 100)]
    states = []
    expected: list[list[tuple[Image, Depth]]] = [[], []]
    for step in range(7):
        data.qpos[:3] = [0.03 * step, -0.2, 0.05]
        mujoco.mj_forward(model, data)
        states.append(state_of(model, data))
        for film, camera, size in zip(expected, cameras, sizes, strict=True):
            film.append(draw(renderer, data, camera, *size))
    pool = _core.RenderPool(model, threads)
    rgb = [np.zeros((7, *size, 3), np.uint8) for size in sizes]
    depth = [None, np.zeros((7, *sizes[1]), np.uint16)]
    pool.render_states(np.array(states), cameras, rgb, depth)
    pool.render_states(np.zeros((0, pool.state_size)), cameras, [film[:0] for film in rgb])
    pool.close()
    for film, wanted in zip(rgb, expected, strict=True):
        np.testing.assert_array_equal(film, [picture for picture, _ in wanted])
    np.testing.assert_array_equal(depth[1], [picture for _, picture in expected[1]])
    assert not np.array_equal(rgb[1][0], rgb[1][6])


@pytest.mark.gl
def test_a_pool_draws_each_copy_of_a_world_with_its_own_colours_lights_cameras_and_sizes(make: MakeRenderer) -> None:
    model, data = build()
    world = World(model, copies=4, threads=2)
    green, top = model.geom("green").id, model.camera("top").id
    world.vary("geom_rgba")[1, green] = [0, 0, 1, 1]
    world.vary("light_diffuse")[2] = 0.0
    world.vary("cam_fovy")[3, top] = 30.0
    world.vary("geom_size")[3, green] *= 1.5
    pool = _core.RenderPool(model, 3)
    rgb = [np.zeros((4, 64, 64, 3), np.uint8)]
    pool.render_states(world.core.states, [top], rgb, None, world.core)
    assert len({picture.tobytes() for picture in rgb[0]}) == 4
    for copy in range(4):
        single = mujoco.MjModel.from_xml_string(SCENE)
        for field in ("geom_rgba", "light_diffuse", "cam_fovy", "geom_size"):
            getattr(single, field)[:] = world.field(field)[copy]
        np.testing.assert_array_equal(draw(make(single), data, top, 64, 64)[0], rgb[0][copy])
    with pytest.raises(ValueError, match="has 4 simulations"):
        pool.render_states(world.core.states[:2], [top], [rgb[0][:2]], None, world.core)
    pool.close()
    other = mujoco.MjModel.from_xml_string(SCENE.replace("<visual>", '<asset><material name="m"/></asset><visual>'))
    pool = _core.RenderPool(other, 1)
    with pytest.raises(ValueError, match="another one than the pool's"):
        pool.render_states(world.core.states, [top], rgb, None, world.core)
    pool.close()


@pytest.mark.gl
def test_a_pool_refuses_arrays_that_do_not_belong_together() -> None:
    model, data = build()
    pool = _core.RenderPool(model, 1)
    states = np.stack([state_of(model, data)] * 2)
    rgb = np.zeros((2, 8, 8, 3), np.uint8)
    with pytest.raises(ValueError, match="rows of"):
        pool.render_states(states[:, 1:], [0], [rgb])
    with pytest.raises(ValueError, match="one picture for each row"):
        pool.render_states(states, [0], [rgb[:1]])
    with pytest.raises(ValueError, match="one entry for each camera"):
        pool.render_states(states, [0, 1], [rgb])
    with pytest.raises(ValueError, match="height and width"):
        pool.render_states(states, [0], [rgb], [np.zeros((2, 8, 9), np.uint16)])
    with pytest.raises(ValueError, match="no camera -1"):
        pool.render_states(states, [-1], [rgb])
    with pytest.raises(TypeError):
        pool.render_states(states, [0], [rgb[:, :, ::2]])
    pool.close()


@pytest.mark.gl
def test_a_renderer_and_a_pool_keep_their_model_alive() -> None:
    model, data = build()
    states = np.stack([state_of(model, data)] * 2)
    expected, again = np.zeros((2, 8, 8, 3), np.uint8), np.zeros((2, 8, 8, 3), np.uint8)
    renderer, pool = _core.Renderer(model), _core.RenderPool(model, 2)
    pool.render_states(states, [0], [expected])
    kept = weakref.ref(model)
    del model, data
    gc.collect()
    assert kept() is not None
    pool.render_states(states, [0], [again])
    np.testing.assert_array_equal(again, expected)
    renderer.update_from_state(states[0])
    renderer.render(0, again[0])
    np.testing.assert_array_equal(again[0], expected[0])
    renderer.close()
    pool.close()


@pytest.mark.gl
def test_a_callback_cannot_draw_the_copies_of_the_world_that_steps() -> None:
    model, _ = build()
    world, pool = World(model, frequency=1 / model.opt.timestep, copies=2, threads=2), _core.RenderPool(model, 1)
    world.vary("geom_rgba")
    rgb = np.zeros((2, 8, 8, 3), np.uint8)
    states = world.core.states.copy()
    world.core.on_period(
        Callback(lambda view: pool.render_states(states, [0], [rgb], None, world.core)), model.opt.timestep
    )
    with pytest.raises(WrongOrder, match="while advance is under way"):
        world.advance()
    world.close()
    pool.close()


POOL = """
    import mujoco, numpy as np, os, resource, sys
    from rcs import _core
    from rcs.errors import WrongOrder
    model = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody><geom size='.1'/><camera pos='0 0 1'/></worldbody></mujoco>"
    )
    rgb = np.zeros((2, 8, 8, 3), np.uint8)
"""


@pytest.mark.gl
def test_a_pool_whose_threads_cannot_start_is_refused(run_program: RunProgram) -> None:
    # A thread's stack is as large as the limit at the start of the program: the first one fits, the second does not.
    program = (
        """
    import os, resource, sys
    if "OPENBLAS_NUM_THREADS" not in os.environ:
        resource.setrlimit(resource.RLIMIT_STACK, (1 << 30, resource.getrlimit(resource.RLIMIT_STACK)[1]))
        os.execve(sys.executable, [sys.executable, *sys.orig_argv[1:]], {**os.environ, "OPENBLAS_NUM_THREADS": "1"})
    """
        + POOL
        + """
    _core.RenderPool(model, 1).close()
    used = int(open("/proc/self/statm").read().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + (1 << 30) + (1 << 29),) * 2)
    try:
        _core.RenderPool(model, 4)
    except RuntimeError as error:
        print("refused")
    """
    )
    answer = run_program(program)
    assert (answer.stdout.strip(), answer.returncode) == ("refused", 0), answer.stderr


@pytest.mark.gl
def test_a_pool_in_the_child_of_a_fork_says_so_and_does_not_hang(run_program: RunProgram) -> None:
    program = (
        POOL
        + """
    pool = _core.RenderPool(model, 3)
    states = np.zeros((2, pool.state_size))
    pool.render_states(states, [0], [rgb])
    child = os.fork()
    if child == 0:
        try:
            pool.render_states(states, [0], [rgb])
        except WrongOrder as error:
            print("after a fork" in str(error), flush=True)
        pool.close()
        pool.close()
        del pool
        os._exit(7)  # as multiprocessing does; on the way out, Mesa itself waits for threads that are in the parent
    print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
    pool.render_states(states, [0], [rgb])
    pool.close()
    """
    )
    answer = run_program(program)
    assert (answer.stdout.split(), answer.returncode) == (["True", "7"], 0), answer.stderr
