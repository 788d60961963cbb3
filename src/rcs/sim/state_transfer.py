"""Transfers states between scenes with the same joints that differ in fixed parts such as cameras."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from rcs.errors import InvalidSetup

_PER_BODY = 6
"""Numbers per body in a state: its external force."""


class StateTransfer:
    """Writes states of one model as states of another with the same joints and actuators.

    A state has a force for every body, so an additional camera makes it longer. Bodies are matched by name; those only
    in the target get no force.
    """

    def __init__(self, source: mujoco.MjModel, target: mujoco.MjModel) -> None:
        """Match two models.

        Args:
            source: The model of given states.
            target: The model of returned states.

        Raises:
            InvalidSetup: Their joints, actuators or other parts of the state differ.
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
                assert len(common) > 0  # both have the world
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
        """Return the corresponding states of the target.

        Args:
            states: States of the source, (..., size).

        Raises:
            InvalidSetup: Their size differs from the source's.
        """
        if states.shape[-1] != self._source_size:
            raise InvalidSetup(of_another_simulation(states.shape[-1], self._source_size))
        carried = np.zeros((*states.shape[:-1], self._size))
        carried[..., self._writes] = states[..., self._reads]
        return carried


def of_another_simulation(given: int, own: int) -> str:
    """Return the words for states whose size is not that of the same scene's."""
    return (
        f"The recorded states have {given} numbers; states of this scene have {own}. They are of another version of "
        "this package, whose simulation moves differently: the recorded actions would end elsewhere. The recording can "
        "be read, viewed and exported; `rcs data replay --kind states` has simulated robots follow its joints."
    )


def _parts() -> list[tuple[str, int]]:
    """Return name and bit of all parts of a state, in storage order."""
    whole = int(mujoco.mjtState.mjSTATE_INTEGRATION.value)
    parts = {int(part.value): name for name, part in mujoco.mjtState.__members__.items()}
    return [(parts[bit], bit) for bit in sorted(parts) if bit & whole and bit & (bit - 1) == 0]


def _names(model: mujoco.MjModel, kind: str) -> list[str]:
    if kind == "jnt":
        return [model.joint(i).name for i in range(model.njnt)] + [model.actuator(i).name for i in range(model.nu)]
    return [model.body(i).name for i in range(model.nbody)]


def _bodies(model: mujoco.MjModel) -> NDArray[np.str_]:
    """Return the names of all bodies; unnamed ones are numbered."""
    names = [model.body(i).name for i in range(model.nbody)]
    return np.array([name or f"\0{i}" for i, name in enumerate(names)])
