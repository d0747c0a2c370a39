from .encoders import (
    Bins as Bins,
    FlatDict as FlatDict,
    FunctionEncoder as FunctionEncoder,
    MiniGridFullView as MiniGridFullView,
    MiniGridView as MiniGridView,
    StackedFrames as StackedFrames,
)
from .environment import TaskEnvironment as TaskEnvironment, to_gymnasium as to_gymnasium
from .gymnasium import from_gymnasium as from_gymnasium, observation_task as observation_task
from .potential_shaping import (
    PotentialShaping as PotentialShaping,
    VectorPotentialShaping as VectorPotentialShaping,
)
from .tabulation.exploration import Progress as Progress
from .tabulation.minigrid import MiniGridState as MiniGridState
from .tabulation.states import DeepCopy as DeepCopy
from .tabulation.tabulate import tabulate as tabulate
from .tabulation.tabulated_task import (
    ObservationTable as ObservationTable,
    TabulatedTask as TabulatedTask,
    TabulationRecord as TabulationRecord,
)
from .trackers import Tracker as Tracker, Trackers as Trackers, checkpoints as checkpoints
