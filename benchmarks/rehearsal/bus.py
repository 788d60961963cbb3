"""Count wrong readings of an SO101's five joints in motion while packets are late, lost and damaged.

A reading is right when the servo was there between the request and the answer, by the robot's own log, within a step of
the encoder.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np
from rehearsal.stage import stage

from rcs.errors import DeviceFault
from rcs.hardware.servo_bus import TIMEOUT
from rcs.hardware.so101_servos import ARM, GOAL, Servos, read_calibration

FAULTS = (("late", "20/100"), ("lose", "1/100"), ("corrupt", "1/100"))
STEP = 2 * np.pi / 4096


def measure(reads: int) -> dict[str, Any]:
    """Return the figures of so many reads of one servo each."""
    found: list[tuple[float, float, list[float]]] = []
    refused = 0
    with stage("so101") as one:
        address = one.site.arms["so101"]
        servos = Servos(address.address)
        servos.check(read_calibration(address.options["calibration"]), TIMEOUT)
        calibration = servos.calibration
        servos.power(ARM)
        start = {servo: servos.read().positions[servo] for servo in ARM}
        for fault in FAULTS:
            one.virtual.tell(*fault)
        begin = time.monotonic()
        for k in range(reads // len(ARM)):
            if k % 5 == 0:  # all of them, differently, so that no answer fits another request
                way = 200 * np.sin((time.monotonic() - begin) * np.linspace(2.0, 3.0, len(ARM)))
                goals = {servo: round(start[servo] + step) for servo, step in zip(ARM, way, strict=True)}
                servos.bus.write_all(GOAL[0], goals)
            asked = time.monotonic()
            try:
                reading = servos.read()
            except DeviceFault:
                refused += 1
                continue
            joints = [calibration[servo].joint(reading.positions[servo]) for servo in ARM]
            found.append((asked, time.monotonic(), joints))
        seconds = time.monotonic() - begin
        repeated = servos.bus.failures
        servos.release(ARM)
        servos.bus.close()
        one.virtual.close()
        ticks = one.ticks()
    times, places = np.ascontiguousarray(ticks["time"]), ticks["joints"]  # a view would be copied at each search
    wrong, worst = 0, 0.0
    for asked, answered, joints in found:
        # A servo's answer was measured at the end of the tick before.
        first, last = np.searchsorted(times, asked) - 3, np.searchsorted(times, answered) + 1
        near = places[max(first, 0) : last]
        beside = np.maximum(near.min(axis=0) - joints, joints - near.max(axis=0))
        wrong += int((beside > STEP).sum())
        worst = max(worst, float(beside.max()))
    return {
        "reads": len(ARM) * len(found),
        "wrong": wrong,
        "refused": len(ARM) * refused,
        "repeated_requests": repeated,
        "worst_mrad": round(1e3 * worst, 2),
        "reads_per_second": round(len(ARM) * len(found) / seconds),
    }
