"""Carries states over between scenes that differ in what hangs on them, such as cameras, and in nothing that moves."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from rcs.errors import InvalidSetup

_PER_BODY = 6
"""Numbers of an external force per body in a state."""


class StateTransfer:
    """Writes states of one model as states of another with the same joints and actuators.

    A state has a force for every body, so that one more camera makes it longer. Bodies are matched by name; a body
    that only the other model has gets no force.
    """

    def __init__(self, source: mujoco.MjModel, target: mujoco.MjModel) -> None:
        """Match two models.

        Args:
            source: The model that states come from.
            target: The model that they are for.

        Raises:
            InvalidSetup: Their joints or actuators differ, or whatever else is in a state.
        """
        if (joints := _names(source, "jnt")) != _names(target, "jnt"):
            raise InvalidSetup(
                f"States of one scene do not fit another with other joints: {joints} and {_names(target, 'jnt')}."
            )
        self._size = mujoco.mj_stateSize(target, mujoco.mjtState.mjSTATE_INTEGRATION.value)
        reads: list[NDArray[np.intp]] = []
        writes: list[NDArray[np.intp]] = []
        read = write = 0
        for name, part in _parts():
            sizes = [mujoco.mj_stateSize(model, part) for model in (source, target)]
            if part == mujoco.mjtState.mjSTATE_XFRC_APPLIED.value:
                common, from_rows, to_rows = np.intersect1d(_bodies(source), _bodies(target), return_indices=True)
                columns = np.arange(_PER_BODY)
                reads.append((read + _PER_BODY * from_rows[:, None] + columns).ravel())
                writes.append((write + _PER_BODY * to_rows[:, None] + columns).ravel())
                assert len(common) > 0  # the world is in both
            elif sizes[0] != sizes[1]:
                raise InvalidSetup(
                    f"States of one scene do not fit another: {name} has {sizes[0]} numbers in one and "
                    f"{sizes[1]} in the other."
                )
            else:
                reads.append(read + np.arange(sizes[0]))
                writes.append(write + np.arange(sizes[0]))
            read += sizes[0]
            write += sizes[1]
        self._reads, self._writes = np.concatenate(reads), np.concatenate(writes)
        self._source_size = read

    def __call__(self, states: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return states as those of the target.

        Args:
            states: States of the source, (..., size).

        Raises:
            InvalidSetup: They have another size than the source's.
        """
        if states.shape[-1] != self._source_size:
            raise InvalidSetup(f"A state has {states.shape[-1]} numbers; this scene's have {self._source_size}.")
        carried = np.zeros((*states.shape[:-1], self._size))
        carried[..., self._writes] = states[..., self._reads]
        return carried


def _parts() -> list[tuple[str, int]]:
    """Return name and bit of all parts of a state, in the order in which they are stored."""
    whole = int(mujoco.mjtState.mjSTATE_INTEGRATION.value)
    parts = {int(part.value): name for name, part in mujoco.mjtState.__members__.items()}
    return [(parts[bit], bit) for bit in sorted(parts) if bit & whole and bit & (bit - 1) == 0]


def _names(model: mujoco.MjModel, kind: str) -> list[str]:
    if kind == "jnt":
        return [model.joint(i).name for i in range(model.njnt)] + [model.actuator(i).name for i in range(model.nu)]
    return [model.body(i).name for i in range(model.nbody)]


def _bodies(model: mujoco.MjModel) -> NDArray[np.str_]:
    """Return the names of all bodies; those without one get a name by their number among such, which is as good."""
    names = [model.body(i).name for i in range(model.nbody)]
    return np.array([name or f"\0{i}" for i, name in enumerate(names)])
