"""Observers: they see every step and change nothing (the paper's identity wrappers)."""

from rcs.envs.observers.observer import Observer, Transition

__all__ = ["Observer", "Transition"]
