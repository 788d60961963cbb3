"""The world's end of the process that draws virtual cameras."""

from __future__ import annotations

import signal
import subprocess
import sys
from typing import Any

from rcs.virtual.sensors import VirtualSensors


def test_a_process_that_does_not_answer_is_ended() -> None:
    sensors: Any = object.__new__(VirtualSensors)
    with subprocess.Popen(
        [sys.executable, "-c", "import time; time.sleep(60)"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        sensors._process = process
        assert sensors._ask({"sensor": "wrist"}, 0.05) == {}
        assert process.wait(5.0) == -signal.SIGKILL
