"""Real devices: sites, which name the driver and address of each device, and the drivers."""

from rcs_data.lazy import load_on_use

load_on_use(__name__)
