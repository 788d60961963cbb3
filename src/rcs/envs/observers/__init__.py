"""Observers: they see every step and change nothing (the paper's identity wrappers)."""
