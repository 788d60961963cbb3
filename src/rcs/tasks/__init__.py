"""Tasks: what is in the scene, how an episode starts, and what counts as success."""

from rcs_data.lazy import load_on_use

load_on_use(__name__)
