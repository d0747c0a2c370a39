"""Training a task seen through observations over many seeds: :func:`learn_deep`."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from curricle.arrays import IntArray
from curricle.checks import instance
from curricle.deep.learner import DeepLearner, check_spaces
from curricle.deep.miniature import Miniatures
from curricle.deep.policy import DeepResult
from curricle.deep.shaping import PolicyReuse
from curricle.errors import SettingError
from curricle.files import Place, place_at
from curricle.learning.record import WarmUp
from curricle.learning.result import learning_result
from curricle.learning.seeds import seed_settings
from curricle.learning.shaping import Shaping
from curricle.learning.stopping import (
    NEVER_STOPS,
    Budget,
    Episodes,
    StoppingKernel,
    StoppingRule,
    levels,
    limits,
    longest_run,
    spacing,
)
from curricle.planning.policy_evaluation import GreedyEvaluation
from curricle.planning.target import not_solved
from curricle.progress import Progress, check_progress, shown
from curricle.tasks.observation_task import ObservationTask
from curricle.transfer.potential import ObservationPotential
from curricle.transfer.rollouts import target_of


def learn_deep(
    task: ObservationTask,
    learner: DeepLearner | None = None,
    budget: Budget = 100_000,
    *,
    seeds: int | Sequence[int] = 1,
    shaping: Shaping | Sequence[Shaping] | None = None,
    eval_freq: int | None = None,
    evaluation: GreedyEvaluation | None = None,
    stream: str = "",
    warm_up: Sequence[WarmUp] | None = None,
    charged: Sequence[int] | IntArray | None = None,
    saves: str | Place | None = None,
    progress: Progress = None,
) -> DeepResult:
    """Return what a deep learner learns of a task, for each of several seeds, one after another.

    Parameters
    ----------
    task : ObservationTask
    learner : DeepLearner
        By default DQN with the settings of Stable-Baselines3.
    budget : int, Episodes or StoppingRule
        As in :func:`learn`. A run ends at the first step of its sub-environments that reaches the
        budget; a rollout that is cut off is not learnt from.
    seeds : int or sequence of int
        As in :func:`learn`; torch's version and the machine round differently.
    shaping : Shaping or sequence of K Shaping, optional
        One for all seeds or one for each, of an :class:`ObservationPotential` or another
        ``ValueSource``:

        - :class:`QInitialisation`, :class:`LookAheadAdvice`: Q(s, a) = phi(s, a) + residual(s, a)
          wherever DQN reads its network; the residual starts at 0 (Wiewiora 2003).
        - :class:`StateShaping`: F = gamma Phi(s') - Phi(s) is added to rewards, for any algorithm.
        - :class:`WeightTransfer`, :class:`PolicyReuse`: the one source's network, or the sources'
          policy and not their values, is carried over.
    eval_freq, stream, warm_up, charged
        As in :func:`learn`.
    evaluation : GreedyEvaluation, optional
        By rollouts, 5 by default.
    saves : path, optional
        A folder or a URL for checkpoints, from which a killed run resumes, with the same result.
    progress : bool or callable, optional
        True shows a bar for each seed; a function is called with each seed when it is done.

    Returns
    -------
    DeepResult
        A :class:`LearningResult` whose ``values`` are K :class:`NetworkValues`, with ``policies``.

    Raises
    ------
    SettingError, ImportError
        When an argument is invalid, or Stable-Baselines3 not installed, before anything runs.

    Examples
    --------
    >>> from curricle import observation_task
    >>> learner = DeepLearner("DQN", settings={"learning_starts": 50})
    >>> result = learn_deep(observation_task("CartPole-v1"), learner, 200, seeds=[3], eval_freq=100)
    >>> result.steps, result.steps_used, result.values[0].of_actions
    (array([  0, 100, 200]), array([200]), True)
    """
    check_progress(progress)
    learner = DeepLearner() if learner is None else learner
    evaluation = GreedyEvaluation() if evaluation is None else evaluation
    instance("a task for a deep learner", task, ObservationTask, SettingError)
    instance("learner", learner, DeepLearner, SettingError)
    if isinstance(task, Miniatures):
        raise SettingError(
            "miniatures are solved and distilled, as a task of a Curriculum, and not learnt by "
            f"steps: got {task}"
        )
    check_spaces(task, learner)
    learner.algorithm_class()
    instance("evaluation", evaluation, GreedyEvaluation, SettingError)
    check_evaluation(evaluation)
    if evaluation.method != "off":
        evaluation.horizon(task)  # SettingError without a bound
    steps, episodes = limits(budget)
    eval_freq = spacing(eval_freq, budget)
    longest = longest_run(task.longest, budget, eval_freq)
    settings = seed_settings(
        seeds,
        learner,
        (steps, episodes),
        lambda shaping: _of_observations(task, learner, shaping, budget),
        shaping=shaping,
        warm_up=warm_up,
        charged=charged,
    )
    stopping: StoppingKernel = NEVER_STOPS
    if isinstance(budget, StoppingRule):
        if budget.fraction is not None:
            raise not_solved(budget.fraction, task)
        stopping = budget.kernel(*levels(budget, task, evaluation, target_of))
    from curricle.deep.models import DeepRun  # needs Stable-Baselines3

    lengths = steps, episodes, eval_freq, longest
    run = DeepRun(task, learner, *lengths, evaluation, stopping, stream)
    outcomes = []
    with shown(progress) as bars:
        for of_seed in settings:
            place = None if saves is None else place_at(saves) / f"seed-{of_seed.seed}.checkpoint"
            name = f"{stream or 'learning'}, seed {of_seed.seed}"
            reached = bars.bar(name, longest // eval_freq + 1)
            outcomes.append(replace(run, reached=reached).train(*of_seed, place))
            bars.tell(of_seed.seed)
    numbers = tuple(of_seed.seed for of_seed in settings)
    values: Any = tuple(outcome.values for outcome in outcomes)
    result = learning_result(task, learner, numbers, values, outcomes, eval_freq)  # type: ignore[arg-type]
    return DeepResult.of(result)


def check_evaluation(evaluation: GreedyEvaluation) -> None:
    """Raise SettingError unless networks can be evaluated so."""
    if evaluation.method == "exact":
        raise SettingError(
            "an exact evaluation needs tables, and networks are evaluated by rollouts: got "
            f"{evaluation}"
        )


def _of_observations(
    task: ObservationTask, learner: DeepLearner, shaping: Shaping, budget: Budget
) -> Shaping:
    """Return the shaping with a potential of the task's observations."""
    potential = shaping.potential
    if potential is None:
        return shaping
    if not isinstance(potential, ObservationPotential):
        potential = ObservationPotential.of(task, potential)
    if potential.task != task:
        raise SettingError(
            f"a potential must be made for the task it shapes: it belongs to {potential.task}"
        )
    acts = isinstance(shaping, PolicyReuse) and potential.of_actions
    acts = acts and "buffer_size" in learner.takes
    if isinstance(budget, Episodes) and (getattr(shaping, "kl", 0.0) > 0 or acts):
        raise SettingError(
            "a source's policy pulls, or acts, over the first half of a budget in steps: "
            f"{shaping.name} got {budget}"
        )
    of_states = shaping.starts_at_potential and not potential.of_actions
    if of_states and "buffer_size" in learner.takes:
        raise SettingError(
            f"{shaping.name} needs a potential of numbered actions; StateShaping does not"
        )
    return shaping.with_potential(potential)
