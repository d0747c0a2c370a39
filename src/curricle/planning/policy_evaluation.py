"""Evaluation of greedy policies, exactly or by rollouts."""

from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, get_args

import numpy as np
import numpy.typing as npt

from curricle.arrays import BoolArray, FloatArray, IntArray
from curricle.checks import instance, number, one_of, whole_number
from curricle.errors import SettingError
from curricle.planning.greedy import ACTION, TIED, Values, VisitedValues, acting_row, greedy_action
from curricle.planning.rollouts import GreedyPolicy, ReturnRecord, simulate_episode
from curricle.progress import HALTED
from curricle.tasks.graph import improper_states
from curricle.tasks.kernel import (
    address_of,
    called,
    compiled,
    draw,
    inlined,
    overloaded,
    stream_start,
)
from curricle.tasks.live import is_live, open_model
from curricle.tasks.mdp import (
    NO_LIMIT,
    Task,
    closed,
    generative_model,
    has_tables,
    table_model,
    tables,
)
from curricle.tasks.models import (
    Tables,
    evaluation_model,
    first_state,
    has_users_code,
    truncated,
)
from curricle.tasks.observation_task import is_observation_task
from curricle.tasks.spaces import state_name

Method = Literal["auto", "exact", "rollouts", "off"]
EPISODES, LIVE_EPISODES = 100, 5
"""Rollouts per checkpoint; fewer in a live task, whose steps take a hundred times longer."""
MOST_EPISODES = 1_000_000
"""Rollouts at most: their mean varies a thousandth of a return; more would seem to hang."""
LARGEST_EXACT = 20_000  # outcomes (S x A x O) up to which ``method="auto"`` is exact
NEGLIGIBLE = 1e-9
"""Probability (or discounted weight) of not having ended at which an evaluation stops."""
LONGEST_HORIZON = 10_000_000  # steps of an evaluation that no time limit ends
SLICE = 2**16  # steps between two looks at whether the run was interrupted
EVALUATION_STREAM = 0x5851F42D4C957F2D
"""Separates the random stream of evaluations from that of learning."""


class RolloutEvaluation(NamedTuple):
    """The evaluation by the mean return of rollouts."""

    episodes: int
    discount: float  # the task's, or 1
    horizon: int  # steps of an episode
    stream: npt.NDArray[np.uint64]  # (1,)
    total: FloatArray  # (2,) work space
    taken: IntArray  # (1,) steps of all episodes so far
    halted: BoolArray  # (1,) true once nobody waits for it
    address: int = 0  # where :meth:`compiled_for` has put the machine code

    def for_run(self, start: int) -> "RolloutEvaluation":
        """Return this for a run whose random stream starts at `start`."""
        stream, total = np.array([start ^ EVALUATION_STREAM], dtype=np.uint64), np.zeros(2)
        return RolloutEvaluation(*self[:3], stream, total, np.zeros(1, np.int64), HALTED.get())

    def compiled_for(self, model: object, view: object) -> "RolloutEvaluation":
        """Return this with its machine code for such a view in such a model."""
        loop = compiled(rollout_return, has_users_code(model))
        return self._replace(address=address_of(loop, self, model, view))


class GreedyChain(NamedTuple):
    """The Markov chain that a greedy policy makes of a task, of the states that it reaches."""

    first: IntArray  # (S,) where a state's transitions begin; -1 where it is not reached
    end: IntArray  # (S,) where they end
    reward: FloatArray  # (S,) expected reward of a step
    goes_on: FloatArray  # (S,) probability that a step does not terminate
    next_state: npt.NDArray[np.integer[Any]]  # (P,) int32, each at most once a state, none terminal
    probability: FloatArray  # (P,)
    place: IntArray  # (S,) work space: where a next state was written last
    values: FloatArray  # (1, A) work space


class ExactEvaluation(NamedTuple):
    """The exact evaluation, by the distribution over states at each step."""

    tables: Tables
    discount: float
    horizon: int
    negligible: float  # probability of not having ended below which to stop
    mass: FloatArray  # (2, S) work space: probability of each state, now and next
    alive: IntArray  # (2, S) work space: the states where that is not 0
    chain: GreedyChain  # work space
    halted: BoolArray  # (1,) true once nobody waits for it
    address: int = 0  # where :meth:`compiled_for` has put the machine code

    @classmethod
    def of(
        cls, tables: Tables, discount: float, horizon: int, size: tuple[int, int]
    ) -> "ExactEvaluation":
        """Return the evaluation with work space for so many states and actions."""
        n_states, n_actions = size
        # Room for the chain of any policy; memory that no state reaches is never used.
        most = n_states * min(n_actions * tables.probability.shape[1], n_states)
        first, end, place = np.zeros((3, n_states), np.int64)
        reward, goes_on = np.zeros((2, n_states))
        edges = np.empty(most, np.int32), np.empty(most)
        chain = GreedyChain(first, end, reward, goes_on, *edges, place, np.zeros((1, n_actions)))
        mass, alive = np.zeros((2, n_states)), np.zeros((2, n_states), np.int64)
        return cls(tables, discount, horizon, NEGLIGIBLE, mass, alive, chain, HALTED.get())

    def for_run(self, start: int) -> "ExactEvaluation":
        """Return this with work space for a run."""
        return self.of(*self[:3], self.tables.outcome_row.shape)

    def compiled_for(self, model: object, view: object) -> "ExactEvaluation":
        """Return this with its machine code for such a view; it needs no model but its tables."""
        fixed = fixed_values.bodies.get(type(view), lambda view: view)(view)
        return self._replace(address=address_of(compiled(exact_return, False), self, fixed))


class NoEvaluation(NamedTuple):
    """No evaluation: every return is NaN."""

    def for_run(self, start: int) -> "NoEvaluation":
        """Return this."""
        return self

    def compiled_for(self, model: object, view: object) -> "NoEvaluation":
        """Return this."""
        return self


EvaluationKernel = ExactEvaluation | RolloutEvaluation | NoEvaluation


def steps_of(evaluation: EvaluationKernel) -> int:
    """Return the steps that an evaluation has taken: none where it reads tables."""
    return int(evaluation.taken[0]) if isinstance(evaluation, RolloutEvaluation) else 0


@dataclass(frozen=True)
class GreedyEvaluation:
    """How the greedy policy is evaluated at each checkpoint.

    It estimates the expected return of one episode from the start distribution, cut at the time
    limit, ties broken uniformly, in the task's own (unshaped) rewards. No budget is charged for it:
    an exact evaluation takes no steps, and ``LearningResult.evaluation_steps`` counts the steps of
    rollouts. SettingError on invalid settings.

    Parameters
    ----------
    method : {"auto", "exact", "rollouts", "off"}
        "exact" propagates the distribution over states; "rollouts" takes the mean of some episodes.
        "auto" is exact up to 20,000 outcomes (states x actions x outcomes of a pair). With "off"
        greedy returns are NaN. Networks are evaluated by rollouts.
    episodes : int, optional
        Rollouts per checkpoint; by default 100, and 5 in a live task.
    discounted : bool, optional
        Whether rewards are discounted, as in :func:`solve`, or summed, as in the paper. By default
        tables are evaluated with the discount, networks without.
    sampled : bool
        Draw actions from the policy of an actor-critic instead of taking the likeliest. Where
        observations hide a part of the state, the likeliest actions can lead in circles.

    Examples
    --------
    >>> GreedyEvaluation(method="rollouts", episodes=10)
    GreedyEvaluation(method='rollouts', episodes=10, discounted=None, sampled=False)
    """

    method: Method = "auto"
    episodes: int | None = None
    discounted: bool | None = None
    sampled: bool = False

    def __post_init__(self) -> None:
        one_of("method", self.method, get_args(Method), SettingError)
        if self.episodes is not None:
            name = "episodes of an evaluation"
            episodes = whole_number(name, self.episodes, 1, SettingError)
            number(name, episodes, SettingError, high=MOST_EPISODES)
        if self.discounted is not None:
            instance("discounted", self.discounted, bool, SettingError)
        instance("sampled", self.sampled, bool, SettingError)

    def kernel(self, task: Task) -> EvaluationKernel:
        """Return the evaluation of this task for compiled loops."""
        if self.method == "off":
            return NoEvaluation()
        if self.sampled:
            raise SettingError("sampled=True needs the policy of a network: a table has none")
        horizon = self.horizon(task)
        discount = self.discount(task)
        exact, pairs = self.method == "exact", task.states.size * task.actions.size
        if self.method == "auto" and pairs <= LARGEST_EXACT and has_tables(task):
            exact = pairs * tables(task).probability.shape[1] <= LARGEST_EXACT
        if exact:
            return ExactEvaluation.of(table_model(tables(task)), discount, horizon, (0, 0))
        none = np.zeros(0, np.uint64), np.zeros(0), np.zeros(0, np.int64), HALTED.get()
        return RolloutEvaluation(self.rollouts(task), discount, horizon, *none)

    def discount(self, task: Any) -> float:
        """Return the discount of the evaluation in a task: the task's own, or 1."""
        networks = is_observation_task(task)
        discounted = not networks if self.discounted is None else self.discounted
        model = task if networks else generative_model(task)
        return float(model.discount) if discounted else 1.0

    def rollouts(self, task: object) -> int:
        """Return the episodes that rollouts take the mean of, in a task of any kind."""
        few = is_observation_task(task) or is_live(task)
        return self.episodes or (LIVE_EPISODES if few else EPISODES)

    def horizon(self, task: Any) -> int:
        """Return the steps after which an episode is cut off, or adds a negligible return."""
        observed = is_observation_task(task)
        model = task if observed else generative_model(task)
        limit, discount = task.longest if observed else model.time_limit, model.discount
        if limit is not None:
            return int(limit)
        if self.discounted is False or (observed and self.discount(task) == 1):
            raise SettingError(
                "an undiscounted evaluation needs a task with a time limit, time_limit=: none set"
            )
        horizon = 1 if discount == 0 else int(NO_LIMIT)
        if 0 < discount < 1:
            horizon = min(horizon, int(np.ceil(np.log(NEGLIGIBLE) / np.log(discount))))
        long = horizon > LONGEST_HORIZON and has_tables(task)
        if long and (endless := improper_states(tables(task))).size:
            raise SettingError(
                f"an evaluation at discount {discount!r} needs a time limit, time_limit=, where "
                "episodes can go on for ever: they can from "
                f"{state_name(task.states, int(endless[0]))}"
            )
        return horizon


class Evaluated(NamedTuple):
    """The expected return of a policy, and the steps that rollouts took for it."""

    value: float
    steps: int


def greedy_policy_return(
    task: Task, view: object, evaluation: GreedyEvaluation, *, seed: int = 0, stream: str = ""
) -> Evaluated:
    """Return the expected return of the policy that is greedy on a view (:func:`greedy_action`).

    Rollouts draw as :func:`learn` does at step 0 for the same seed and stream.
    """
    start = stream_start(seed, stream)
    kernel = evaluation.kernel(task).for_run(start)
    if isinstance(kernel, NoEvaluation):
        return Evaluated(np.nan, 0)
    if isinstance(kernel, ExactEvaluation):
        if isinstance(view, Values | VisitedValues):  # one type, as of the tables that learn
            values = np.zeros(kernel.tables.outcome_row.shape)
            values[view.states if isinstance(view, VisitedValues) else ...] = view.values
            view = Values(closed(values, tables(task).available))
        return Evaluated(float(compiled(exact_return, False)(kernel, view)), 0)
    with open_model(generative_model(task), start) as model:
        loop = compiled(rollout_return, has_users_code(model))
        value = float(loop(kernel, model, view))
    return Evaluated(value, steps_of(kernel))


# -- compiled ------------------------------------------------------------------------------------


@overloaded()
def greedy_return(evaluation, model, view):
    """Return the expected return of the policy that is greedy on a view, to the horizon."""


@overloaded(otherwise=lambda view: view)
def fixed_values(view):
    """Return the values that a view is greedy on as a view of fewer types; by default itself."""


@greedy_return.body(NoEvaluation)
def _no_return(evaluation, model, view):
    return np.nan


@greedy_return.body(RolloutEvaluation)
def _rollout_return(evaluation, model, view):
    return called(evaluation.address, (evaluation, model, view))


@greedy_return.body(ExactEvaluation)
def _exact_return(evaluation, model, view):
    return called(evaluation.address, (evaluation, fixed_values(view)))


@inlined  # it counts no references, like those that give it the model
def mean_of_rollouts(evaluation, model, view):
    """Return the mean return of episodes of the greedy policy."""
    played, stream, total = evaluation_model(model), evaluation.stream, evaluation.total
    record, policy = ReturnRecord(evaluation.discount, total), GreedyPolicy(view)
    total[0] = 0.0
    for _ in range(evaluation.episodes):
        state, total[1] = first_state(played, draw(stream)), 1.0
        remaining, goes_on = evaluation.horizon, True
        while goes_on:
            most = remaining if remaining < SLICE else SLICE
            n, state, terminated = simulate_episode(played, policy, state, stream, most, record, 0)
            evaluation.taken[0] += n
            remaining -= n
            ended = terminated or truncated(played) or evaluation.halted[0]
            goes_on = remaining > 0 and not ended
        if evaluation.halted[0]:
            break
    return total[0] / evaluation.episodes


def rollout_return(evaluation, model, view):
    """Return the mean return of episodes of the greedy policy."""
    return mean_of_rollouts(evaluation, model, view)


def exact_return(evaluation, view):
    """Return the expected return of the greedy policy, from its Markov chain."""
    return return_of_chain(evaluation, view)


@inlined
def write_chain(evaluation, view):
    """Write the chain of the greedy policy, from the start states to all that it reaches."""
    tables, chain, reached = evaluation.tables, evaluation.chain, evaluation.alive[0]
    for state in range(chain.first.shape[0]):  # an assignment of all compiles for longer
        chain.first[state] = -1
    n_reached, end = tables.start_states.shape[0], np.int64(0)
    for i in range(n_reached):
        reached[i] = tables.start_states[i]
        chain.first[reached[i]] = 0
    i = 0
    while i < n_reached:
        state = reached[i]
        action = greedy_action(view, np.uint64(state), np.uint64(0))
        if action >= TIED:
            acting_row(view, np.uint64(state), chain.values)
        begin, end = end, write_transitions(chain, tables, state, action, end)
        for k in range(begin, end):
            after = chain.next_state[k]
            if chain.first[after] < 0:
                chain.first[after] = 0
                reached[n_reached] = after
                n_reached += 1
        i += 1


@inlined
def write_transitions(chain, tables, state, action, end):
    """Write the transitions from a state at `end`; return where they end.

    They are the action's; if it is flagged, those of all actions that tie in `chain.values`.
    """
    first, last, ties, best = action, action + np.uint64(1), 1, 0.0
    if action >= TIED:
        best = chain.values[0, action & ACTION]
        first, last, ties = np.uint64(0), np.uint64(chain.values.shape[1]), 0
        for i in range(last):
            ties += chain.values[0, i] == best
    begin, reward, goes_on = end, 0.0, 0.0
    for i in range(first, last):
        if ties > 1 and chain.values[0, i] != best:
            continue
        row = tables.outcome_row[state, i]
        for outcome in range(tables.probability.shape[1]):
            part = tables.probability[row, outcome] / ties
            if part > 0.0:
                reward += part * tables.reward[row, outcome]
                after = tables.next_state[row, outcome]
                if not tables.terminal[after]:
                    goes_on += part
                    k = chain.place[after]
                    if k < begin or k >= end or chain.next_state[k] != after:
                        k, chain.place[after] = end, end
                        chain.next_state[k], chain.probability[k] = after, 0.0
                        end += 1
                    chain.probability[k] += part
    chain.first[state], chain.end[state] = begin, end
    chain.reward[state], chain.goes_on[state] = reward, goes_on
    return end


@inlined
def return_of_chain(evaluation, view):
    """Return the expected return from the start to the horizon in the greedy policy's chain."""
    write_chain(evaluation, view)
    tables, chain = evaluation.tables, evaluation.chain
    mass, alive = evaluation.mass, evaluation.alive
    now, n_alive, before = 0, tables.start_states.shape[0], 0.0
    for i in range(n_alive):
        state = tables.start_states[i]
        alive[now, i] = state
        mass[now, state] = tables.start_cumulative[i] - before
        before = tables.start_cumulative[i]

    total, weight = 0.0, 1.0
    for step in range(evaluation.horizon):
        n_next, in_play = 0, 0.0
        for i in range(n_alive):
            state = alive[now, i]
            chance = mass[now, state]
            mass[now, state] = 0.0
            total += weight * chance * chain.reward[state]
            in_play += chance * chain.goes_on[state]
            for k in range(chain.first[state], chain.end[state]):
                after, part = chain.next_state[k], chance * chain.probability[k]
                if part > 0.0:
                    if mass[1 - now, after] == 0.0:
                        alive[1 - now, n_next] = after
                        n_next += 1
                    mass[1 - now, after] += part
        now, n_alive = 1 - now, n_next
        weight *= evaluation.discount
        # Until there is a reward, a discount ends nothing: a far goal may be all there is to earn.
        unearned = in_play if total == 0.0 else in_play * weight
        ends = unearned < evaluation.negligible or step == evaluation.horizon - 1
        if ends or evaluation.halted[0]:
            for i in range(n_alive):
                mass[now, alive[now, i]] = 0.0
            break
    return total
