"""Draws the cameras of a simulation in real time beside the loop: steps hand over states, a thread draws the newest.

A step in which frames are due costs the loop a copy of the state. The frames come when they are drawn, with the time of
the state that they show; where drawing is slower than the cameras' rate, the newest state is drawn next, and the ones
in between are skipped and counted. The model may change between episodes: what is drawn meanwhile, nobody sees.
"""

from __future__ import annotations

import threading

from rcs.errors import InvalidSetup
from rcs.sim.camera import FrameArrays, SimCameras, Snapshot
from rcs.sim.frame_clock import FrameClock


class RenderThread:
    """The newest frame of every camera of a world of one copy, drawn by a thread; takes the place of a `CameraFeed`."""

    def __init__(self, cameras: SimCameras, clock: FrameClock) -> None:
        """Deliver the frames of some cameras. The thread starts with the first `read`.

        Args:
            cameras: They draw; nobody else reads them.
            clock: Says when a frame is due; it has all of these cameras, and nobody else takes frames from it.

        Raises:
            InvalidSetup: The cameras' world has many copies.
        """
        if cameras.world.leading:
            raise InvalidSetup("A RenderThread draws one copy; the frames of many copies come from a CameraFeed.")
        self.skipped = dict.fromkeys(cameras.names, 0)
        """Frames of each camera that were due and never drawn, as a newer state came first."""
        self._cameras = cameras
        self._clock = clock
        self._changed = threading.Condition()
        self._due: dict[str, Snapshot] = {}
        self._drawn: dict[str, tuple[Snapshot, FrameArrays]] = {}
        self._capture_times: dict[str, float] = {}
        self._error: Exception | None = None
        self._thread: threading.Thread | None = None
        self._is_ending = False

    @property
    def capture_times(self) -> dict[str, float]:
        """When the simulation was as each camera's last frame shows it [s], on the monotonic clock."""
        return self._capture_times

    def read(self) -> dict[str, FrameArrays]:
        """Hand over the present state for the cameras that have a frame due, and return each camera's newest frame.

        At the start of an episode, wait until every camera has drawn it, so that nobody sees the one before.

        Returns:
            As `SimCameras.read`. A camera without a new frame gives the same arrays again.

        Raises:
            MissingDependency: There is no OpenGL.
            SimulationError: MuJoCo could not draw.
        """
        if self._thread is None:
            self._thread = threading.Thread(target=self._run, name="render cameras", daemon=True)
            self._thread.start()
        is_new = self._clock.take()
        is_start = self._cameras.world.core.steps[0] == 0 or not self._drawn
        names = [name for name in self._cameras.names if is_start or is_new[name][0]]
        snapshot = self._cameras.snapshot(names) if names else None
        with self._changed:
            if is_start:
                self._due.clear()
            for name in names:
                self.skipped[name] += name in self._due
                assert snapshot is not None
                self._due[name] = snapshot
            self._changed.notify_all()
            if is_start:
                self._changed.wait_for(lambda: self._error is not None or self._shows(snapshot))
            if self._error is not None:
                raise self._error
            newest = dict(self._drawn)
        self._capture_times = {name: newest[name][0].time for name in self._cameras.names}
        return {name: dict(newest[name][1]) for name in self._cameras.names}

    def close(self) -> None:
        """End the thread and free the renderer. Closing twice is harmless; reading again starts anew."""
        with self._changed:
            self._is_ending = True
            self._changed.notify_all()
        if self._thread is not None:
            self._thread.join()
        self._thread, self._error, self._is_ending = None, None, False
        self._due.clear()
        self._drawn.clear()
        self._cameras.close()

    def _shows(self, snapshot: Snapshot | None) -> bool:
        return all(name in self._drawn and self._drawn[name][0] is snapshot for name in self._cameras.names)

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._due or self._is_ending)
                if self._is_ending:
                    return
                due, self._due = self._due, {}
            try:
                for snapshot in dict.fromkeys(due.values()):
                    names = [name for name in due if due[name] is snapshot]
                    for name, frame in self._cameras.draw(snapshot, names):
                        with self._changed:
                            self._drawn[name] = (snapshot, frame)
                            self._changed.notify_all()
            except Exception as err:  # noqa: BLE001  raised where the loop is, by its next `read`
                with self._changed:
                    self._error = err
                    self._changed.notify_all()
                return
