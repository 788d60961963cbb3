"""The arm whose kinematics are tested."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from rcs.kinematics import DampedLeastSquares, attach_end_effector, kinematics_of, load
from rcs.robots.fr3 import FR3
from rcs.robots.franka_hand import FRANKA_HAND


@pytest.fixture(scope="session")
def model() -> mujoco.MjModel:
    """The FR3 with the Franka Hand, as MuJoCo sees it."""
    spec = load(FR3)
    attach_end_effector(spec, FR3, FRANKA_HAND)
    return spec.compile()


@pytest.fixture(scope="session")
def solver() -> DampedLeastSquares:
    return kinematics_of(FR3, FRANKA_HAND)


@pytest.fixture
def random_joints() -> NDArray[np.float64]:
    """200 joint vectors, anywhere inside the limits."""
    rng = np.random.default_rng(1)
    return rng.uniform(FR3.joint_lower, FR3.joint_upper, (200, 7))
