from .block_dude import BlockDude as BlockDude
from .cliff_walking import CliffWalking as CliffWalking
from .computed import ComputedMDP as ComputedMDP
from .deep_sea import DeepSea as DeepSea
from .draws import (
    bernoulli as bernoulli,
    integers as integers,
    splitmix64 as splitmix64,
    uniform as uniform,
)
from .families.blocks import (
    block_dude_family as block_dude_family,
    block_mapping as block_mapping,
    part_of_level as part_of_level,
)
from .families.cliffs import cliff_walking_family as cliff_walking_family
from .families.components_by_name import ComponentsByName as ComponentsByName
from .families.family import (
    FamilyMember as FamilyMember,
    TaskFamily as TaskFamily,
    task_family as task_family,
)
from .families.lakes import (
    frozen_lake_family as frozen_lake_family,
    part_of_lake as part_of_lake,
)
from .families.mazes import maze_family as maze_family, random_maze as random_maze
from .families.parameters import Parameter as Parameter
from .families.pursuits import (
    pursuit_family as pursuit_family,
    pursuit_mappings as pursuit_mappings,
)
from .families.rivers import (
    river as river,
    river_mapping as river_mapping,
    river_swim_family as river_swim_family,
)
from .families.rooms import (
    four_rooms_family as four_rooms_family,
    four_rooms_mapping as four_rooms_mapping,
    four_rooms_task as four_rooms_task,
    key_lock_pit_family as key_lock_pit_family,
    key_lock_pit_mapping as key_lock_pit_mapping,
    key_lock_pit_task as key_lock_pit_task,
)
from .families.seas import (
    deep_sea_family as deep_sea_family,
    sea as sea,
    sea_mapping as sea_mapping,
)
from .families.taxis import taxi_family as taxi_family
from .four_rooms import FourRooms as FourRooms
from .frozen_lake import FrozenLake as FrozenLake, random_lake as random_lake
from .gridworld import GridWorld as GridWorld, Rewards as Rewards
from .key_lock_pit import KeyLockPit as KeyLockPit
from .live import LiveMDP as LiveMDP
from .mdp import FiniteMDP as FiniteMDP
from .observation_task import ObservationTask as ObservationTask
from .pursuit import Pursuit as Pursuit
from .river_swim import RiverSwim as RiverSwim
from .spaces import Component as Component, Space as Space
from .start_states import (
    GoalDistance as GoalDistance,
    TaskWithStart as TaskWithStart,
    goal_distance as goal_distance,
    goal_states as goal_states,
    with_start as with_start,
)
from .task import Task as Task
from .taxi import Taxi as Taxi
