"""Forward and inverse kinematics of a robot from its description."""

from rcs_data.lazy import load_on_use

load_on_use(__name__)
