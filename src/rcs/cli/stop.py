"""`rcs stop`: the devices of all hosts hold."""

from __future__ import annotations

from dataclasses import dataclass

from rcs.hardware.hosted import stop_hosts


@dataclass(kw_only=True)
class StopCommand:
    """Have the devices of all hosts of this user hold, from any terminal. Exit code 1 if a host did not answer."""

    def run(self) -> int:
        """Stop, and print what came of it."""
        outcomes = stop_hosts()
        for name, outcome in outcomes.items():
            print(f"{name}: {outcome}")
        if not outcomes:
            print("No host is running. Devices that run in their program itself are stopped there, by Ctrl-C.")
        return 1 if any("killed" in outcome for outcome in outcomes.values()) else 0
