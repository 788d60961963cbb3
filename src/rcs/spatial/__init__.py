"""Poses and conversions between their representations; the only place that knows about quaternion order."""

from rcs_data.lazy import load_on_use

load_on_use(__name__)
