"""The frames of simulated cameras as devices deliver them: a new one when it is due, in between the last one again."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcs.sim.camera import SimCameras
from rcs.sim.frame_clock import FrameClock

Frame = dict[str, NDArray[Any]]


class CameraFeed:
    """The newest frame of every camera and copy. Only what is due is drawn."""

    def __init__(self, cameras: SimCameras, clock: FrameClock) -> None:
        """Deliver the frames of some cameras.

        Args:
            cameras: They draw.
            clock: Says when; it has all of these cameras, and nobody else takes frames from it.
        """
        self._cameras = cameras
        self._clock = clock
        self._is_batch = bool(cameras.world.leading)
        self._last: dict[str, Frame] = {}

    def read(self) -> dict[str, Frame]:
        """Return what `SimCameras.read` does, but as each camera took it last: picture, depth and camera pose."""
        is_new = self._clock.take()
        always = [name for name in self._cameras.names if self._clock.has_frame_each_step(name)]
        whole = [name for name in self._cameras.names if name in always or is_new[name].all()]
        drawn = self._cameras.read(whole) if whole else {}
        # Nobody sees a frame of `always` again, so it need not be kept.
        self._last.update({name: drawn[name] for name in whole if name not in always})
        # Cameras with a frame in the same copies are drawn together.
        partly: dict[bytes, list[str]] = {}
        for name in self._cameras.names:
            if name not in whole and is_new[name].any():
                partly.setdefault(is_new[name].tobytes(), []).append(name)
        for flags, names in partly.items():
            copies = np.flatnonzero(np.frombuffer(flags, np.bool_)).astype(np.int32)
            for name, frame in self._cameras.read(names, copies).items():
                for key, values in frame.items():
                    self._last[name][key][copies] = values
        return {name: drawn[name] if name in always else _copy(self._last[name]) for name in self._cameras.names}


def _copy(frame: Frame) -> Frame:
    # What is handed out may be written to, and the frame may be handed out again.
    return {key: values.copy() for key, values in frame.items()}
