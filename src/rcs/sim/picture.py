"""Pictures of a whole scene, for people."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from rcs._core import Renderer
from rcs.errors import InvalidSetup
from rcs.sim.camera import Quality
from rcs.sim.scene import OVERVIEW
from rcs.sim.viewer import Viewer
from rcs.sim.world import World


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
