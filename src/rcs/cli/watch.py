"""Watch a collection in MuJoCo's viewer."""

from __future__ import annotations

from rich.console import Console

from rcs.envs.observer import Show
from rcs.rollout.collect import Collection, Progress, collect
from rcs.setups.make import make
from rcs.sim.viewer import Viewer


def watch_collection(collection: Collection, console: Console) -> int:
    """Collect in real time in this process, with a window; closing the window ends the collection."""
    env = make(collection.setup)
    progress = Progress()
    with Viewer(env.simulation.world) as viewer:
        env.add_observer(Show(viewer))
        for attempt in collect(collection, progress, env):
            verdict = "success" if attempt.result.success else f"failure ({attempt.result.failure})"
            console.print(f"episode {attempt.number}: {verdict}, {attempt.result.steps} steps")
            if not viewer.is_running:
                progress.is_interrupted = True
    return 0
