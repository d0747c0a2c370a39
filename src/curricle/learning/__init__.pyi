from .learners import (
    SARSA as SARSA,
    DoubleQLearning as DoubleQLearning,
    ExpectedSARSA as ExpectedSARSA,
    Learner as Learner,
    OptimisticQLearning as OptimisticQLearning,
    QLearning as QLearning,
    RMax as RMax,
    value_bounds as value_bounds,
)
from .portfolio import Portfolio as Portfolio
from .potential import (
    MappedPotential as MappedPotential,
    StateActionPotential as StateActionPotential,
    StatePotential as StatePotential,
)
from .record import Snapshots as Snapshots
from .result import LearningResult as LearningResult
from .run import learn as learn
from .schedules import (
    Schedule as Schedule,
    exponential as exponential,
    harmonic as harmonic,
    linear as linear,
)
from .shaping import (
    LookAheadAdvice as LookAheadAdvice,
    QInitialisation as QInitialisation,
    RewardBonus as RewardBonus,
    Shaping as Shaping,
    StateShaping as StateShaping,
)
from .stopping import Episodes as Episodes, StoppingRule as StoppingRule
from .storage import SparseValues as SparseValues, Storage as Storage
from .tabular_policy import TabularPolicy as TabularPolicy
