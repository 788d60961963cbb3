from rcs.envs.observers.observer import Observer as Observer
from rcs.envs.observers.observer import Transition as Transition
