from rcs.envs.observer import Observer as Observer
from rcs.envs.observer import Transition as Transition
from rcs.envs.observers.drift_check import DriftCheck as DriftCheck
