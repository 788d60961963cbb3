"""Prints the readings of a device, a line each.

Arguments: its module, class, address ("" for None), for how long [s], and nodes for whose input umockdev waits for us.
"""

from __future__ import annotations

import json
import os
import sys
import time
from importlib import import_module
from typing import Any

from rcs.teleop.device import InputDevice


def out(**values: Any) -> None:
    print(json.dumps(values), flush=True)  # noqa: T201


def main(module: str, name: str, address: str, seconds: str, *nodes: str) -> None:
    device: InputDevice = getattr(import_module(module), name)(address or None)
    try:
        device.open()
        out(open=True)
        for node in nodes:
            os.write(os.open(node, os.O_RDWR | os.O_NOCTTY), b"go")
        end = time.monotonic() + float(seconds)
        while time.monotonic() < end:
            if (reading := device.read()) is None:
                continue
            hands = {
                hand: {
                    "twist": None if own.twist is None else own.twist.tolist(),
                    "buttons": sorted(own.buttons), "opening": own.opening, "is_tracked": own.is_tracked,
                }
                for hand, own in reading.hands.items()
            }  # fmt: skip
            out(age=time.monotonic() - reading.time, counts=dict(reading.counts), hands=hands)
    except Exception as err:  # noqa: BLE001 - the test looks at it
        out(error=type(err).__name__, message=str(err))
    finally:
        device.close()


if __name__ == "__main__":
    main(*sys.argv[1:])
