from rcs.envs.observers.drift_check import DriftCheck as DriftCheck
from rcs.envs.observers.observer import Observer as Observer
from rcs.envs.observers.observer import Transition as Transition
