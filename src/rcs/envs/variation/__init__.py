"""Variation from episode to episode: ranges are drawn, and the model and the state are written."""
