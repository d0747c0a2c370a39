from .computed import ComputedMDP as ComputedMDP
from .draws import (
    bernoulli as bernoulli,
    integers as integers,
    splitmix64 as splitmix64,
    uniform as uniform,
)
from .gridworld import GridWorld as GridWorld, Rewards as Rewards
from .live import LiveMDP as LiveMDP
from .mdp import FiniteMDP as FiniteMDP
from .observation_task import ObservationTask as ObservationTask
from .pursuit import Pursuit as Pursuit
from .spaces import Component as Component, Space as Space
from .task import Task as Task
