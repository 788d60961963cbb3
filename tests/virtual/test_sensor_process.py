"""The process that draws virtual cameras answers the loop of its world at once."""

from __future__ import annotations

import json
import os
import queue
import threading
import time
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import rcs
from rcs.virtual import sensor_process, sensors

DRAWING = 2.0
"""How long a drawing takes [s]."""


def test_what_a_writer_left_unfinished_is_not_read(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sensors, "WRITING", 0.01)
    shared = sensors.SharedState(2)
    reader = sensors.SharedState(2, shared.file)
    shared.write(np.array([1.0, 2.0]))
    _, moment = reader.read()
    sensors._HEAD.pack_into(shared._memory, 0, 3, 0.0)  # as if it had been killed
    shared._values[0] = 7.0
    values, same = reader.read()
    assert (values.tolist(), same) == ([1.0, 2.0], moment)
    os.close(shared.file)


class SlowEyes:
    """Eyes with a sensor, that draw for long."""

    draws = threading.Event()

    def __init__(self, *_: Any) -> None:
        self.world = SimpleNamespace(core=SimpleNamespace(state_size=1))
        self.parts = SimpleNamespace(cameras=(), tactile=())
        self.sensors = {"wrist": sensor_process.Sensor("wrist", {})}

    def draw(self) -> None:
        self.draws.set()
        time.sleep(DRAWING)


def test_a_fault_is_answered_while_a_picture_is_drawn(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sensor_process, "Eyes", SlowEyes)
    monkeypatch.setattr(sensor_process, "resolve", lambda setup: None)
    monkeypatch.setattr(sensor_process, "SharedState", lambda size, file: None)
    monkeypatch.setattr(sensor_process, "serve", lambda eyes: SimpleNamespace(server_port=1))
    lines, said = queue.Queue[str](), queue.Queue[Any]()
    thread = threading.Thread(target=sensor_process.main, args=(lines.get, said.put))
    thread.start()
    lines.put(json.dumps({"setup": rcs.Setup().to_json(), "size": 1, "file": 0}))
    assert said.get(timeout=20.0)["port"] == 1
    assert SlowEyes.draws.wait(20.0)
    begin = time.monotonic()
    lines.put(json.dumps({"sensor": "wrist", "fault": "black", "value": ""}))
    assert said.get(timeout=20.0) == {"done": True}
    assert time.monotonic() - begin < 0.5 * DRAWING
    lines.put("")  # the end of the input
    thread.join()
