from . import (
    candidates as candidates,
    certificate as certificate,
    comparison as comparison,
    curriculum as curriculum,
    deep as deep,
    errors as errors,
    interop as interop,
    learning as learning,
    planning as planning,
    show as show,
    statistics as statistics,
    study as study,
    tasks as tasks,
    transfer as transfer,
)
from .certificate.certification import certify as certify
from .curriculum.curriculum import Curriculum as Curriculum
from .errors import CurricleError as CurricleError
from .interop.gymnasium import (
    from_gymnasium as from_gymnasium,
    observation_task as observation_task,
    to_gymnasium as to_gymnasium,
)
from .interop.potential_shaping import PotentialShaping as PotentialShaping
from .interop.tabulation import tabulate as tabulate
from .learning.learners import (
    SARSA as SARSA,
    DoubleQLearning as DoubleQLearning,
    ExpectedSARSA as ExpectedSARSA,
    QLearning as QLearning,
)
from .learning.portfolio import Portfolio as Portfolio
from .learning.potential import (
    StateActionPotential as StateActionPotential,
    StatePotential as StatePotential,
)
from .learning.run import learn as learn
from .learning.shaping import (
    LookAheadAdvice as LookAheadAdvice,
    QInitialisation as QInitialisation,
    RewardBonus as RewardBonus,
    StateShaping as StateShaping,
)
from .learning.stopping import Episodes as Episodes, StoppingRule as StoppingRule
from .learning.storage import Storage as Storage
from .planning.policy_evaluation import GreedyEvaluation as GreedyEvaluation
from .planning.solution import evaluate as evaluate, solve as solve
from .show.plots import plot as plot
from .study.config import compare as compare, forecast as forecast, read_study as read_study
from .study.running import run_study as run_study
from .study.tuning import choose as choose
from .tasks.gridworld import GridWorld as GridWorld, Rewards as Rewards
from .tasks.mdp import FiniteMDP as FiniteMDP
from .tasks.models import ComputedMDP as ComputedMDP
from .tasks.pursuit import Pursuit as Pursuit
from .tasks.spaces import Component as Component, Space as Space
from .transfer.aggregate import maximum as maximum, mean as mean, minimum as minimum, total as total
from .transfer.by_components import project as project, same_position as same_position
from .transfer.mapping import from_function as from_function
from .transfer.transfer import Transfer as Transfer

__version__: str
