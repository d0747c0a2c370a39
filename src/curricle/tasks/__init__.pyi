from .computed import ComputedMDP as ComputedMDP
from .deep_sea import DeepSea as DeepSea
from .draws import (
    bernoulli as bernoulli,
    integers as integers,
    splitmix64 as splitmix64,
    uniform as uniform,
)
from .families.components_by_name import ComponentsByName as ComponentsByName
from .families.family import (
    FamilyMember as FamilyMember,
    TaskFamily as TaskFamily,
    task_family as task_family,
)
from .families.mazes import maze_family as maze_family, random_maze as random_maze
from .families.parameters import Parameter as Parameter
from .families.pursuits import (
    pursuit_family as pursuit_family,
    pursuit_mappings as pursuit_mappings,
)
from .four_rooms import FourRooms as FourRooms
from .gridworld import GridWorld as GridWorld, Rewards as Rewards
from .key_lock_pit import KeyLockPit as KeyLockPit
from .live import LiveMDP as LiveMDP
from .mdp import FiniteMDP as FiniteMDP
from .observation_task import ObservationTask as ObservationTask
from .pursuit import Pursuit as Pursuit
from .river_swim import RiverSwim as RiverSwim
from .spaces import Component as Component, Space as Space
from .task import Task as Task
