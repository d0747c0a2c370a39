from .encoders import (
    Bins as Bins,
    MiniGridFullView as MiniGridFullView,
    MiniGridView as MiniGridView,
    WholeNumbers as WholeNumbers,
)
from .gymnasium import (
    from_gymnasium as from_gymnasium,
    observation_task as observation_task,
    to_gymnasium as to_gymnasium,
)
from .minigrid import MiniGridState as MiniGridState
from .potential_shaping import PotentialShaping as PotentialShaping
from .states import DeepCopy as DeepCopy
from .tabulated_task import (
    ObservationTable as ObservationTable,
    TabulatedTask as TabulatedTask,
    TabulationRecord as TabulationRecord,
)
from .tabulation import tabulate as tabulate
from .trackers import Tracker as Tracker, Trackers as Trackers, checkpoints as checkpoints
