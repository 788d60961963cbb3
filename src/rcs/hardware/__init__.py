"""Real devices by name: a site says which drivers reach them and where."""

from rcs_data.lazy import load_on_use

load_on_use(__name__)
