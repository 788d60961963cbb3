"""Pictures and a window that show a whole scene to people."""

from __future__ import annotations

import threading
import warnings
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from rcs._core import Renderer
from rcs.errors import InvalidSetup, MissingDependency
from rcs.sim.camera import Quality
from rcs.sim.scene import OVERVIEW
from rcs.sim.world import World

NO_GLFW = "The viewer needs glfw: pip install 'mujoco-core[rendering]'."


def has_display() -> bool:
    """Return whether a window can be opened here.

    Raises:
        MissingDependency: There is no window library.
    """
    try:
        import glfw
    except ImportError as err:
        raise MissingDependency(NO_GLFW) from err
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # GLFW's own message on a missing display; the caller raises a better one
        return bool(glfw.init())


class Picture:
    """Draws a world of one copy from the overview camera, or shows it in MuJoCo's own viewer."""

    def __init__(self, world: World, *, size: tuple[int, int] = (640, 480), quality: Quality = "fast") -> None:
        """Prepare to draw a world.

        Args:
            world: A world of one copy.
            size: Width and height [px].
            quality: Rendering quality.

        Raises:
            InvalidSetup: The world has many copies.
        """
        if world.data is None:
            raise InvalidSetup("Pictures need a world of one copy.")
        self._world = world
        self._data = world.data
        self._size = size
        self._quality: Quality = quality
        self._camera = world.model.camera(OVERVIEW).id
        self._renderer: Renderer | None = None
        self._window: Any = None
        self._window_threads: set[threading.Thread] = set()

    def draw(self) -> NDArray[np.uint8]:
        """Return a picture, (H, W, 3), rows from the top."""
        width, height = self._size
        model = self._world.model
        if self._renderer is None:
            self._renderer = Renderer(model, quality=self._quality, max_width=width, max_height=height)
        picture = np.empty((height, width, 3), np.uint8)
        mujoco.mj_camlight(model, self._data)
        self._renderer.update(self._data)
        self._renderer.render(self._camera, picture)
        return picture

    def show(self) -> None:
        """Show the present state in a window, which is opened at the first call; take changes by its panels and mouse.

        Raises:
            MissingDependency: There is no display or no window library.
        """
        if self._window is None:
            self._window = self._open_window()
        if self._window.is_running():
            self._window.sync()

    def _open_window(self) -> Any:
        try:
            import mujoco.viewer
        except ImportError as err:
            raise MissingDependency(NO_GLFW) from err
        if not has_display():
            raise MissingDependency(
                "The viewer needs a display and there is none (or GLFW cannot reach it). "
                "Without a window, look at report.html, or use `rcs sim`."
            )
        before = set(threading.enumerate())
        window = mujoco.viewer.launch_passive(self._world.model, self._data, show_left_ui=False, show_right_ui=False)
        # The handle hides its thread, and a program that ends before that thread crashes in it.
        self._window_threads = set(threading.enumerate()) - before
        return window

    def close(self) -> None:
        """Free the renderer and close the window. Closing twice is harmless."""
        if self._window is not None:
            self._window.close()
            self._window = None
            for thread in self._window_threads:
                thread.join()
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None
