from .block_dude import BlockDude as BlockDude
from .cliff_walking import CliffWalking as CliffWalking
from .deep_sea import DeepSea as DeepSea
from .families.built_in import (
    block_dude_family as block_dude_family,
    cliff_walking_family as cliff_walking_family,
    deep_sea_family as deep_sea_family,
    four_rooms_family as four_rooms_family,
    frozen_lake_family as frozen_lake_family,
    key_lock_pit_family as key_lock_pit_family,
    pursuit_family as pursuit_family,
    river_swim_family as river_swim_family,
    taxi_family as taxi_family,
)
from .family import (
    ComponentsByName as ComponentsByName,
    FamilyMember as FamilyMember,
    Parameter as Parameter,
    TaskFamily as TaskFamily,
    task_family as task_family,
)
from .four_rooms import FourRooms as FourRooms
from .frozen_lake import FrozenLake as FrozenLake
from .gridworld import GridWorld as GridWorld, Rewards as Rewards
from .kernel import (
    bernoulli as bernoulli,
    integers as integers,
    splitmix64 as splitmix64,
    uniform as uniform,
)
from .key_lock_pit import KeyLockPit as KeyLockPit
from .live import LiveMDP as LiveMDP
from .mazes import maze_family as maze_family, random_maze as random_maze
from .mdp import FiniteMDP as FiniteMDP, Task as Task
from .models import ComputedMDP as ComputedMDP
from .observation_task import ObservationTask as ObservationTask
from .pursuit import Pursuit as Pursuit
from .river_swim import RiverSwim as RiverSwim
from .spaces import Component as Component, Space as Space
from .start_states import (
    GoalDistance as GoalDistance,
    goal_distance as goal_distance,
    with_start as with_start,
)
from .taxi import Taxi as Taxi
