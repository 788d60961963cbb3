from rcs.policy.agent import NOTES as NOTES
from rcs.policy.agent import ChunkAgent as ChunkAgent
from rcs.policy.agent import ServedPolicy as ServedPolicy
from rcs.policy.execution import Execution as Execution
from rcs.policy.interface import fitted as fitted
from rcs.policy.interface import offer_of as offer_of
