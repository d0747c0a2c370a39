from .automaton import Automaton as Automaton, with_automaton as with_automaton
from .exploration import (
    DeepSea as DeepSea,
    RiverSwim as RiverSwim,
    deep_sea_family as deep_sea_family,
    river_swim_family as river_swim_family,
)
from .family import (
    ComponentsByName as ComponentsByName,
    FamilyMember as FamilyMember,
    Parameter as Parameter,
    Rule as Rule,
    TaskFamily as TaskFamily,
    task_family as task_family,
)
from .gridworld import (
    GridWorld as GridWorld,
    Rewards as Rewards,
    maze_family as maze_family,
    random_maze as random_maze,
)
from .kernel import (
    bernoulli as bernoulli,
    integers as integers,
    splitmix64 as splitmix64,
    uniform as uniform,
)
from .live import LiveMDP as LiveMDP
from .mdp import FiniteMDP as FiniteMDP, Task as Task
from .model_files import read_model as read_model
from .models import ComputedMDP as ComputedMDP
from .observation_task import ObservationTask as ObservationTask
from .pursuit import Pursuit as Pursuit, pursuit_family as pursuit_family
from .rooms import (
    FourRooms as FourRooms,
    KeyLockPit as KeyLockPit,
    four_rooms_family as four_rooms_family,
    key_lock_pit_family as key_lock_pit_family,
)
from .spaces import Component as Component, Space as Space
from .start_states import (
    GoalDistance as GoalDistance,
    goal_distance as goal_distance,
    with_start as with_start,
)
from .toy_text import (
    CliffWalking as CliffWalking,
    FrozenLake as FrozenLake,
    Taxi as Taxi,
    cliff_walking_family as cliff_walking_family,
    frozen_lake_family as frozen_lake_family,
    taxi_family as taxi_family,
)
