"""Tasks: what is in the scene, how an episode starts, and what counts as success."""
