"""The relay of a Vive by itself, without this library, in front of a wand that moves to the right at 0.1 m/s.

Arguments: the path of the relay, and those of the relay. Run it with `python -S`.
"""

from __future__ import annotations

import importlib.util
import sys
import time
import types
from typing import Any

spec = importlib.util.spec_from_file_location("vive_relay", sys.argv[1])
assert spec is not None
assert spec.loader is not None
relay: Any = importlib.util.module_from_spec(spec)
sys.modules["vive_relay"] = relay
spec.loader.exec_module(relay)
assert not any(name.partition(".")[0] in ("rcs", "numpy") for name in sys.modules)

openvr: Any = types.ModuleType("openvr")
openvr.VRApplication_Background, openvr.init, openvr.VRSystem = 3, lambda kind: None, lambda: None
sys.modules["openvr"] = openvr
begin = time.monotonic()


def tracked(system: Any, openvr: Any) -> list[Any]:
    right = 0.1 * (time.monotonic() - begin)
    return [relay.Tracked(2, True, (1, 0, 0, right, 0, 1, 0, 0, 0, 0, 1, 0), 1 << 2, 0.5, (0, 0))]


relay.tracked, relay.has_ended = tracked, lambda system, openvr: False
relay.main(*sys.argv[2:])
