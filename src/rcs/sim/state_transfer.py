"""Transfers states between scenes with the same joints that differ in fixed parts such as cameras."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from rcs.errors import InvalidSetup

_WHOLE = mujoco.mjtState.mjSTATE_INTEGRATION.value
_FORCES = mujoco.mjtState.mjSTATE_XFRC_APPLIED.value
"""The only part of a state that has numbers for every body: its external wrench."""


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
        joints, own_joints = ([model.joint(i).name for i in range(model.njnt)] for model in (source, target))
        servos, own_servos = ([model.actuator(i).name for i in range(model.nu)] for model in (source, target))
        if (joints, servos) != (own_joints, own_servos):
            raise InvalidSetup(
                f"States of one scene do not fit another with other joints: {joints + servos} and "
                f"{own_joints + own_servos}."
            )
        # In the order of the bits, the parts of a state lie before and after the forces.
        parts = (_WHOLE & (_FORCES - 1), _WHOLE & -(2 * _FORCES))
        sizes, own_sizes = ([mujoco.mj_stateSize(model, part) for part in parts] for model in (source, target))
        if sizes != own_sizes:
            raise InvalidSetup(
                f"States of one scene do not fit another: beside forces, they have {sum(sizes)} numbers in one and "
                f"{sum(own_sizes)} in the other."
            )
        self._before, self._after = sizes
        self._bodies, self._own_bodies = source.nbody, target.nbody
        _, self._rows, self._own_rows = np.intersect1d(_bodies(source), _bodies(target), return_indices=True)

    def __call__(self, states: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the corresponding states of the target.

        Args:
            states: States of the source, (..., size).

        Raises:
            InvalidSetup: Their size differs from the source's.
        """
        size = self._before + 6 * self._bodies + self._after
        if states.shape[-1] != size:
            raise InvalidSetup(of_another_simulation(states.shape[-1], size))
        before, given, after = np.split(states, [self._before, size - self._after], axis=-1)
        forces = np.zeros((*states.shape[:-1], self._own_bodies, 6))
        forces[..., self._own_rows, :] = given.reshape(*states.shape[:-1], self._bodies, 6)[..., self._rows, :]
        return np.concatenate([before, forces.reshape(*states.shape[:-1], -1), after], axis=-1)


def of_another_simulation(given: int, own: int) -> str:
    """Return the error message for states of another size."""
    return (
        f"The recorded states have {given} numbers; states of this scene have {own}. They are of another version of "
        "this package, whose simulation moves differently: the recorded actions would end elsewhere. The recording can "
        "be read, viewed and exported; `rcs data replay --kind states` has simulated robots follow its joints."
    )


def _bodies(model: mujoco.MjModel) -> NDArray[np.str_]:
    """Return the names of all bodies; unnamed ones are numbered."""
    names = [model.body(i).name for i in range(model.nbody)]
    return np.array([name or f"\0{i}" for i, name in enumerate(names)])
