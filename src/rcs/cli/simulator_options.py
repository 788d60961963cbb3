"""Options of commands whose episodes may be in a simulator of another project."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path

from rcs.errors import InvalidSetup
from rcs.rollout.foreign import ForeignSimulator


@dataclass(kw_only=True)
class SimulatorOptions:
    """A simulator of another project."""

    simulator: str | None = None
    """Simulator of another project, in place of the one here: `SIMULATOR:TASK`, such as `libero:libero_spatial/0`,
    `maniskill:PickCube-v1` or `metaworld:pick-place-v3`, which is started, or the address of `vlagents simulate`."""
    simulator_python: Path | None = None
    """Python of the simulator's environment; by default the one that `make sims` has made."""
    simulator_options: tuple[str, ...] = ()
    """Options of the simulator as NAME=VALUE, such as `size=256`."""
    mapping: Path | None = None
    """JSON file with the mapping between simulator and policy, in place of the simulator's own."""

    simulator_certificate: Path | None = None
    """File with the certificate that a simulator's server must be signed by, at an address `vlas://`. The environment
    variable `VLAGENTS_TOKEN` has the token."""

    def foreign(self, excluded: Sequence[str]) -> ForeignSimulator | None:
        """Return the simulator; None for the one here.

        Args:
            excluded: Names of options that were given, and make no sense with it.

        Raises:
            InvalidSetup: There are such, an option is not written as one, or there is no simulator that it is for.
        """
        if self.simulator is None:
            if given := [own.name for own in fields(self) if getattr(self, own.name)]:
                raise InvalidSetup(
                    f"{', '.join(given)} is of a simulator of another project, and none is named; give simulator, too."
                )
            return None
        if excluded:
            raise InvalidSetup(
                f"{', '.join(excluded)} cannot be combined with simulator: that of another project has its own setup, "
                "of which the mapping decides what there is to decide."
            )
        if words := [word for word in self.simulator_options if "=" not in word]:
            raise InvalidSetup(f"simulator_options has {words[0]!r}; valid is NAME=VALUE, such as size=256.")
        options = dict(word.split("=", 1) for word in self.simulator_options)
        return ForeignSimulator(
            name=self.simulator,
            python=self.simulator_python,
            options=options,
            mapping=self.mapping,
            certificate=self.simulator_certificate,
        )
