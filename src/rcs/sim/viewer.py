"""A window that shows a world of one copy; needs a display."""

from __future__ import annotations

import threading
import warnings
from types import TracebackType
from typing import Any, Self

from rcs.errors import InvalidSetup, MissingDependency
from rcs.sim.world import World


class Viewer:
    """MuJoCo's own viewer beside a running environment; a context manager."""

    def __init__(self, world: World) -> None:
        """Prepare to show a world.

        Args:
            world: A world of one copy.

        Raises:
            InvalidSetup: The world has many copies.
        """
        if world.data is None:
            raise InvalidSetup("A viewer shows a world of one copy.")
        self._world = world
        self._handle: Any = None
        self._threads: set[threading.Thread] = set()

    def open(self) -> None:
        """Open the window.

        Raises:
            MissingDependency: There is no display or no window library.
        """
        try:
            import glfw
            import mujoco.viewer
        except ImportError as err:
            raise MissingDependency("The viewer needs glfw: pip install 'mujoco-core[rendering]'.") from err
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # GLFW's own message on a missing display; ours follows
            has_display = glfw.init()
        if not has_display:
            raise MissingDependency(
                "The viewer needs a display and there is none (or GLFW cannot reach it). "
                "Without a window, look at report.html."
            )
        before = set(threading.enumerate())
        self._handle = mujoco.viewer.launch_passive(
            self._world.model, self._world.data, show_left_ui=False, show_right_ui=False
        )
        # The handle hides its thread, and a program that ends before that thread crashes in it.
        self._threads = set(threading.enumerate()) - before

    @property
    def is_running(self) -> bool:
        """Whether the window is open."""
        return self._handle is not None and self._handle.is_running()

    def sync(self) -> None:
        """Show the present state."""
        if self.is_running:
            self._handle.sync()

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
