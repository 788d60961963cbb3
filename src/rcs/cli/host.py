"""`rcs host` and `rcs stop`: the hosts of a site's devices, for longer than one environment, and how all hold."""

from __future__ import annotations

import json
import signal
import sys
import time
from dataclasses import dataclass
from pathlib import Path

from rcs.errors import InvalidSetup
from rcs.hardware import Site
from rcs.hardware.hosted import start_all, stop_hosts
from rcs.hardware.site import places_of


@dataclass(kw_only=True)
class HostCommand:
    """Run the drivers of a site in processes of their own, to which environments attach, until Ctrl-C or SIGTERM.

    Prints one line of JSON when all of them listen.
    """

    site: Path
    """The file of the site."""

    def run(self) -> int:
        """Start a process per address, and wait. Exit code 1 when all have ended by themselves."""
        places = places_of(Site.read(self.site))
        if not places:
            raise InvalidSetup(f"{self.site} has no device that runs in a host; its drivers run in the program itself.")
        signal.signal(signal.SIGTERM, signal.default_int_handler)
        with start_all(places) as hosts:
            about = [{"name": str(place), "process": process.pid} for place, process in hosts.items()]
            print(json.dumps({"hosts": about}), flush=True)
            try:
                while hosts:
                    for place, process in list(hosts.items()):
                        if process.poll() is not None:
                            print(
                                f"The host of {place} has ended; a program that recovers starts another.",
                                file=sys.stderr,
                            )
                            del hosts[place]
                    time.sleep(0.1)
            except KeyboardInterrupt:
                return 0
            return 1


@dataclass(kw_only=True)
class StopCommand:
    """Have the devices of all hosts of this user hold, from any terminal. Exit code 1 if a host did not answer."""

    def run(self) -> int:
        """Stop, and print the outcomes."""
        outcomes = stop_hosts()
        for name, outcome in outcomes.items():
            print(f"{name}: {outcome}")
        if not outcomes:
            print("No host is running. Devices that run in their program itself are stopped there, by Ctrl-C.")
        return 1 if any("killed" in outcome for outcome in outcomes.values()) else 0
