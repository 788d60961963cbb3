"""The port of simulated tactile sensors: their frames stand next to those of the cameras."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

from gymnasium import spaces

from rcs.envs import spaces as keys
from rcs.envs.ports import Port
from rcs.envs.sim_ports import SimCameraPort
from rcs.envs.spaces import Arrays, Observation
from rcs.errors import InvalidSetup
from rcs.sim.tactile import SimTactile


class SimTactilePort(Port):
    """Tactile sensors as `frames`/sensor/`rgb`, together with the cameras, which give the same key."""

    def __init__(self, sensors: Sequence[SimTactile], cameras: SimCameraPort | None = None) -> None:
        """Use the sensors of a world.

        Args:
            sensors: The sensors.
            cameras: The port of the world's cameras; it is read and closed with this one, and no port of its own.

        Raises:
            InvalidSetup: Two of the sensors and cameras have the same name.
        """
        frames: dict[str, spaces.Space[Any]] = {}
        if cameras is not None:
            space = cameras.observation_spaces[keys.FRAMES]
            assert isinstance(space, spaces.Dict)
            frames.update(space.spaces)
        for sensor in sensors:
            if sensor.placement.name in frames:
                raise InvalidSetup(f"Two cameras or tactile sensors are named {sensor.placement.name!r}.")
            frames[sensor.placement.name] = spaces.Dict({keys.RGB: keys.rgb_space(*sensor.gel.size)})
        self.sensors = list(sensors)
        self.cameras = cameras
        self.action_spaces = {}
        self.observation_spaces = {keys.FRAMES: spaces.Dict(frames)}
        self._times: dict[str, float] = {}

    def observe(self) -> Observation:
        """Read every camera and every sensor."""
        frames: dict[str, Any] = {} if self.cameras is None else dict(self.cameras.observe()[keys.FRAMES])
        for sensor in self.sensors:
            name = sensor.placement.name
            frames[name] = {keys.RGB: sensor.read()[keys.RGB]}
            self._times[f"{keys.FRAMES}/{name}"] = time.perf_counter()
        return {keys.FRAMES: frames}

    def capture_times(self) -> dict[str, float]:
        """Return when each frame was taken."""
        return {**({} if self.cameras is None else self.cameras.capture_times()), **self._times}

    def command(self, action: Arrays) -> None:
        """Do nothing: a sensor takes no commands."""

    def close(self) -> None:
        """Free what drawing needed."""
        if self.cameras is not None:
            self.cameras.close()
        for sensor in self.sensors:
            sensor.close()
