"""Curriculum learning by potential-based reward shaping."""
from curricle.tasks.gridworld import GridWorld, Rewards
from curricle.tasks.pursuit import Pursuit
from curricle.tasks.mdp import FiniteMDP
from curricle.learning.learn import learn, Episodes, GreedyEvaluation, LearningResult
from curricle.learning.learners import QLearning, SARSA, ExpectedSARSA, DoubleQLearning
from curricle.learning.planning import solve, evaluate, greedy_policy
from curricle.learning.potential import StatePotential, StateActionPotential
from curricle.learning.schedules import constant, linear, exponential, harmonic
