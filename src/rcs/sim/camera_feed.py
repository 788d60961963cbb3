"""Delivers the frames of simulated cameras like devices: a new one when it is due, the last one in between."""

from __future__ import annotations

import numpy as np

from rcs.sim.camera import FrameArrays, SimCameras
from rcs.sim.frame_clock import FrameClock


class CameraFeed:
    """The newest frame of every camera and copy, drawn inside `read`. Only due frames are drawn."""

    memory = ("held",)

    def __init__(self, cameras: SimCameras, clock: FrameClock) -> None:
        """Deliver the frames of some cameras.

        Args:
            cameras: Draw the frames.
            clock: Says when frames are due; it has all of these cameras and no other user.
        """
        self._cameras = cameras
        self._clock = clock
        self._last: dict[str, FrameArrays] = {}

    @property
    def capture_times(self) -> dict[str, float]:
        """When each camera's last frame was drawn [s], on the monotonic clock."""
        return self._cameras.capture_times

    def read(self) -> dict[str, FrameArrays]:
        """Return the newest frame of each camera, as `SimCameras.read` does: picture, depth and camera pose.

        The arrays are read-only. A camera without a new frame returns the same arrays again.
        """
        is_new = self._clock.take()
        always = [name for name in self._cameras.names if self._clock.has_frame_each_step(name)]
        whole = [name for name in self._cameras.names if name in always or is_new[name].all()]
        self._last.update(self._cameras.read(whole) if whole else {})
        # Cameras with a frame in the same copies are drawn together.
        partly: dict[bytes, list[str]] = {}
        for name in self._cameras.names:
            if name not in whole and is_new[name].any():
                partly.setdefault(is_new[name].tobytes(), []).append(name)
        for flags, names in partly.items():
            copies = np.flatnonzero(np.frombuffer(flags, np.bool_)).astype(np.int32)
            for name, frame in self._cameras.read(names, copies).items():
                last = {key: values.copy() for key, values in self._last[name].items()}
                for key, values in frame.items():
                    last[key][copies] = values
                    last[key].flags.writeable = False
                self._last[name] = last
        return {name: dict(self._last[name]) for name in self._cameras.names}

    @property
    def held(self) -> dict[str, FrameArrays]:
        """Frames that later steps may show again: those of cameras without a new one in each step."""
        return {name: frame for name, frame in self._last.items() if not self._clock.has_frame_each_step(name)}

    @held.setter
    def held(self, frames: dict[str, FrameArrays]) -> None:
        for frame in frames.values():
            for values in frame.values():
                values.flags.writeable = False
        self._last.update(frames)

    def close(self) -> None:
        """Free the renderer. Closing twice is harmless; reading again makes a new one."""
        self._cameras.close()
