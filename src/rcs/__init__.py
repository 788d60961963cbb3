"""The Robot Control Stack: one Gymnasium API for a simulated or a real robot.

The import registers the ids of `gymnasium.make` (gymnasium 1.4 no longer looks for plugins by itself) and does nothing
else: the public names, listed in `__init__.pyi`, are loaded when they are first used.
"""

from rcs_data.lazy import load_on_use

from rcs.setups.ids import register

load_on_use(
    __name__,
    data="rcs.Dataset, or the package rcs_data",
    list="the command `rcs list`, or rcs.setups.tasks_of(robot)",
    make_env="rcs.make",
    Recorder="rcs.record(env, path)",
)
register()
