from .certificate.certify import certify as certify
from .certificate.verdict import Certificate as Certificate, Counterexample as Counterexample
from .curriculum import Curriculum as Curriculum, CurriculumResult as CurriculumResult
from .deep.agents import AgentsVecEnv as AgentsVecEnv
from .deep.learner import DeepLearner as DeepLearner
from .deep.learning import learn_deep as learn_deep
from .deep.networks import NetworkValues as NetworkValues
from .deep.residual import residual_policy as residual_policy
from .deep.shaped import ShapedVecEnv as ShapedVecEnv
from .errors import (
    CalibrationError as CalibrationError,
    ConfigError as ConfigError,
    CurricleError as CurricleError,
    CurriculumError as CurriculumError,
    MappingError as MappingError,
    PotentialError as PotentialError,
    SettingError as SettingError,
    StoreError as StoreError,
    StudyError as StudyError,
    TaskError as TaskError,
)
from .interop.bins import Bins as Bins
from .interop.environment import (
    TaskEnvironment as TaskEnvironment,
    to_gymnasium as to_gymnasium,
)
from .interop.gymnasium import from_gymnasium as from_gymnasium
from .interop.observed import observed as observed
from .interop.pettingzoo import (
    PursuitParallelEnv as PursuitParallelEnv,
    agent_mappings as agent_mappings,
    to_pettingzoo as to_pettingzoo,
)
from .interop.potential_shaping import PotentialShaping as PotentialShaping
from .interop.tracker import Tracker as Tracker
from .interop.trackers import Trackers as Trackers, open_trackers as open_trackers
from .interop.vector_pursuit import (
    PursuitVectors as PursuitVectors,
    VectorPursuit as VectorPursuit,
    observed_pursuit as observed_pursuit,
    predator_mapping as predator_mapping,
)
from .interop.vector_shaping import VectorPotentialShaping as VectorPotentialShaping
from .learning.budget import Episodes as Episodes
from .learning.evaluation import GreedyEvaluation as GreedyEvaluation
from .learning.film import Film as Film
from .learning.following import Followed as Followed, follow as follow
from .learning.gate import Decision as Decision, Gate as Gate
from .learning.guard import Guard as Guard
from .learning.learn import learn as learn
from .learning.learners import (
    SARSA as SARSA,
    DoubleQLearning as DoubleQLearning,
    ExpectedSARSA as ExpectedSARSA,
    Learner as Learner,
    QLearning as QLearning,
)
from .learning.planning import (
    PolicyValues as PolicyValues,
    Solution as Solution,
    evaluate as evaluate,
    greedy_policy as greedy_policy,
    solve as solve,
)
from .learning.potential import (
    MappedPotential as MappedPotential,
    StateActionPotential as StateActionPotential,
    StatePotential as StatePotential,
)
from .learning.result import LearningResult as LearningResult
from .learning.rollout import Trajectory as Trajectory, rollout as rollout
from .learning.run import Prelude as Prelude
from .learning.schedules import (
    Schedule as Schedule,
    constant as constant,
    exponential as exponential,
    harmonic as harmonic,
    linear as linear,
)
from .learning.storage import SparseValues as SparseValues, Storage as Storage
from .learning.target import Target as Target
from .learning.ways import How as How
from .node import Node as Node
from .report.comparison import draw_comparison as draw_comparison
from .report.flips import collapse_figure as collapse_figure, draw_flips as draw_flips
from .report.forecast import draw_forecast as draw_forecast
from .report.picture import plot as plot
from .report.potentials import draw_potential as draw_potential, draw_sources as draw_sources
from .report.study_page import StudyRecord as StudyRecord, study_page as study_page
from .report.study_report import write_report as write_report
from .returning import Return as Return
from .study.alignment import differences as differences
from .study.attribution import Attribution as Attribution, Region as Region, attribute as attribute
from .study.compare import compare as compare
from .study.comparison import Arm as Arm, Comparison as Comparison, Contrast as Contrast
from .study.config.document import Document as Document
from .study.config.reading import read_study as read_study
from .study.config.study_file import StudyFile as StudyFile
from .study.flips import flips as flips
from .study.forecast import Forecast as Forecast, Foreseen as Foreseen, forecast as forecast
from .study.metrics import (
    Curve as Curve,
    Times as Times,
    asymptotic_performance as asymptotic_performance,
    charge_source as charge_source,
    fraction_of_optimum as fraction_of_optimum,
    jumpstart as jumpstart,
    midpoint as midpoint,
    smooth as smooth,
    steps_saved as steps_saved,
    time_to_threshold as time_to_threshold,
    total_reward as total_reward,
    transfer_ratio as transfer_ratio,
)
from .study.ordering import (
    holm as holm,
    performance_profile as performance_profile,
    probability_of_improvement as probability_of_improvement,
    sign_flip_test as sign_flip_test,
)
from .study.runner.merge import merge as merge
from .study.runner.run import Progress as Progress, run_study as run_study
from .study.runner.study import Study as Study, compared as compared
from .study.runner.unit import Unit as Unit, train_unit as train_unit
from .study.sequential import AddedSeeds as AddedSeeds, add_seeds as add_seeds
from .study.statistics import (
    Interval as Interval,
    bootstrap as bootstrap,
    interquartile_mean as interquartile_mean,
    paired_difference as paired_difference,
    stratified_bootstrap as stratified_bootstrap,
)
from .study.survival import (
    Survival as Survival,
    median_time as median_time,
    restricted_mean_time as restricted_mean_time,
    survival as survival,
)
from .tasks.computed import ComputedMDP as ComputedMDP
from .tasks.draws import below as below, scramble as scramble, unit as unit
from .tasks.gridworld import GridWorld as GridWorld, Rewards as Rewards
from .tasks.live import LiveMDP as LiveMDP
from .tasks.mdp import FiniteMDP as FiniteMDP
from .tasks.observed import ObservedTask as ObservedTask
from .tasks.pursuit import Pursuit as Pursuit
from .tasks.spaces import Component as Component, Space as Space
from .tasks.task import Task as Task
from .transfer.aggregation import (
    maximum as maximum,
    mean as mean,
    minimum as minimum,
    total as total,
)
from .transfer.by_name import ComponentMapping as ComponentMapping, project as project
from .transfer.calibration import (
    Calibration as Calibration,
    calibrate as calibrate,
)
from .transfer.coverage import Coverage as Coverage
from .transfer.edge import Calibrate as Calibrate, Transfer as Transfer
from .transfer.mapping import (
    ENDED as ENDED,
    UNMAPPED as UNMAPPED,
    StateActionMapping as StateActionMapping,
    compose as compose,
    from_function as from_function,
    identity as identity,
    relative_objects as relative_objects,
    same_position as same_position,
)
from .transfer.observed import (
    ObservationMapping as ObservationMapping,
    ObservedCoverage as ObservedCoverage,
)
from .transfer.observed_potential import ObservationPotential as ObservationPotential
from .transfer.realism import Realism as Realism, realism as realism
from .transfer.search import Projection as Projection, find_projections as find_projections
from .transfer.values import (
    FunctionValues as FunctionValues,
    TableValues as TableValues,
    ValueSource as ValueSource,
)
