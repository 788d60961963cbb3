"""Pictures and windows that show a whole scene to people."""

from __future__ import annotations

import threading
import warnings
from collections.abc import Callable
from types import TracebackType
from typing import Any, Self

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


class Viewer:
    """MuJoCo's own viewer beside a running environment; a context manager."""

    def __init__(self, world: World, *, has_panels: bool = False, on_key: Callable[[int], None] | None = None) -> None:
        """Prepare to show a world.

        Args:
            world: A world of one copy.
            has_panels: Start with MuJoCo's panels beside the picture; Tab shows and hides them.
            on_key: Called with the code of a key that is pressed, from the window's own thread; None for nothing.

        Raises:
            InvalidSetup: The world has many copies.
        """
        if world.data is None:
            raise InvalidSetup("A viewer shows a world of one copy.")
        self._world = world
        self._has_panels = has_panels
        self._on_key = on_key
        self._handle: Any = None
        self._threads: set[threading.Thread] = set()

    def open(self) -> None:
        """Open the window.

        Raises:
            MissingDependency: There is no display or no window library.
        """
        try:
            import mujoco.viewer
        except ImportError as err:
            raise MissingDependency(NO_GLFW) from err
        if not has_display():
            raise MissingDependency(
                "The viewer needs a display and there is none (or GLFW cannot reach it). "
                "Without a window, look at report.html, or use `rcs sim --browser`."
            )
        before = set(threading.enumerate())
        self._handle = mujoco.viewer.launch_passive(
            self._world.model,
            self._world.data,
            show_left_ui=self._has_panels,
            show_right_ui=self._has_panels,
            key_callback=self._on_key,
        )
        # The handle hides its thread, and a program that ends before that thread crashes in it.
        self._threads = set(threading.enumerate()) - before

    @property
    def is_running(self) -> bool:
        """True while the window is open."""
        return self._handle is not None and self._handle.is_running()

    def sync(self) -> None:
        """Show the present state, and take changes by panels and mouse into the world's data."""
        if self.is_running:
            self._handle.sync()

    def write(self, left: str, right: str) -> None:
        """Write two columns of lines at the top left of the picture."""
        if self.is_running:
            grid, font = mujoco.mjtGridPos.mjGRID_TOPLEFT, mujoco.mjtFontScale.mjFONTSCALE_150
            self._handle.set_texts((font, grid, left, right))

    def close(self) -> None:
        """Close the window. Closing twice is harmless."""
        if self._handle is not None:
            self._handle.close()
            self._handle = None
            for thread in self._threads:
                thread.join()

    def __enter__(self) -> Self:
        """Open the window."""
        self.open()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close the window."""
        self.close()


class Picture:
    """Draws a world of one copy from the overview camera."""

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
        self._viewer: Viewer | None = None

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
        """Show the present state in a window, which is opened at the first call.

        Raises:
            MissingDependency: There is no display.
        """
        if self._viewer is None:
            self._viewer = Viewer(self._world)
            self._viewer.open()
        self._viewer.sync()

    def close(self) -> None:
        """Free the renderer and close the window. Closing twice is harmless."""
        if self._viewer is not None:
            self._viewer.close()
            self._viewer = None
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None
