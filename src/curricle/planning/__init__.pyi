from .policy_evaluation import GreedyEvaluation as GreedyEvaluation
from .rollouts import Trajectory as Trajectory, rollout as rollout
from .solution import (
    PolicyValues as PolicyValues,
    Solution as Solution,
    evaluate as evaluate,
    greedy_policy as greedy_policy,
    solve as solve,
    visit_distribution as visit_distribution,
)
from .target import Target as Target
