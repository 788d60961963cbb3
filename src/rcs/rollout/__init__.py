"""Rollouts: an agent in an environment, once or a thousand times."""
