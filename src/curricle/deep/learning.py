"""Training a task seen through observations over many seeds, and the results."""

import io
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass, fields, replace
from functools import cached_property
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self, cast

import numpy as np
import numpy.typing as npt

from curricle.arrays import FloatArray, IntArray
from curricle.checks import instance, whole_number
from curricle.deep.learner import DeepLearner, check_spaces
from curricle.deep.miniature import Miniatures
from curricle.errors import CurricleError, SettingError
from curricle.files import local_file, read_saved, write_in_folder
from curricle.interop.tabulated_task import check_sight
from curricle.learning.result import LearningResult, learning_result
from curricle.learning.seeds import seed_settings
from curricle.learning.shaping import QInitialisation, Shaping, StateShaping
from curricle.learning.stopping import (
    Budget,
    StoppingRule,
    limits,
    longest_run,
    spacing,
    stopping_kernel,
)
from curricle.pictures.episode import Episode, played, with_pictures
from curricle.planning.policy_evaluation import GreedyEvaluation
from curricle.planning.target import not_solved
from curricle.progress import Progress, check_progress, shown
from curricle.tasks.kernel import splitmix64, stream_start
from curricle.tasks.observation_task import Observations, ObservationTask, stable_text, stack
from curricle.transfer.potential import ObservationPotential
from curricle.transfer.rollouts import (
    Environments,
    ObservationTarget,
    mean_episode_return,
    target_of,
)

if TYPE_CHECKING:
    from stable_baselines3.common.base_class import BaseAlgorithm

    from curricle.deep.networks import NetworkValues

TOO_LARGE_SEED = 2**32  # the first that NumPy's generator, which SB3 seeds, does not take


@dataclass(frozen=True, eq=False)
class TrainedPolicy:
    """The policy that a deep learner has learnt in a task: ``result.policy`` of its result.

    Parameters
    ----------
    task : ObservationTask
    model : stable_baselines3.common.base_class.BaseAlgorithm
        The algorithm with the trained network.

    Examples
    --------
    >>> from curricle import observation_task
    >>> import numpy as np
    >>> ppo = DeepLearner("PPO", settings={"n_steps": 64})
    >>> policy = learn_deep(observation_task("CartPole-v1"), ppo, 128, eval_freq=64).policy
    >>> policy
    TrainedPolicy(PPO, CartPole-v1)
    >>> policy.predict(np.zeros((3, 4), dtype=np.float32)).shape
    (3,)
    """

    task: ObservationTask
    model: "BaseAlgorithm"

    def predict(
        self, observation: Observations, *, deterministic: bool = True
    ) -> npt.NDArray[Any] | np.generic:
        """Return the action in an observation, (...), or the actions in n stacked ones, (n, ...).

        Without `deterministic` actions are sampled, except by DQN. SettingError where the policy
        also needs memory or masks of actions.
        """
        check_sight(self.model)
        try:
            actions, _ = self.model.predict(observation, deterministic=deterministic)
        except CurricleError:
            raise
        except ValueError as error:
            space = stable_text(self.task.observations)
            raise SettingError(f"a policy takes observations of {space}: {error}") from error
        # a number where it is one: tables look up no arrays
        return actions[()]  # type: ignore[no-any-return]

    def save(self, path: str | Path) -> Path:
        """Write the model as Stable-Baselines3 does, and return the file's path, a ``.zip``.

        It holds pickles: load your own files only, by ``PPO.load`` for instance. SAC's entropy
        coefficient is not kept and starts anew. StoreError when it cannot be written.
        """
        file, content = local_file(path, ".zip"), io.BytesIO()
        self.model.save(content)
        write_in_folder(file, content.getvalue(), "a policy")
        return file

    def episode(
        self, *, seed: int = 0, deterministic: bool = True, max_steps: int | None = None
    ) -> Episode:
        """Return an episode of the policy, with a picture of each step.

        Parameters
        ----------
        seed : int
            Seed of the reset, and of sampled actions.
        deterministic : bool
            As in :meth:`predict`.
        max_steps : int, optional
            Steps after which the episode is cut off; by default the task's own limit.

        Raises
        ------
        SettingError
            When there is no limit, or the environment draws no pictures: a function that makes it
            must set ``render_mode="rgb_array"``, or have that argument.
        """
        limit = self.task.longest if max_steps is None else max_steps
        if limit is None:
            raise SettingError("an episode of a task without a time limit needs max_steps")
        whole_number("max_steps of an episode", limit, 1, SettingError)
        if whole_number("seed", seed, 0, SettingError) >= TOO_LARGE_SEED:
            raise SettingError(f"the seed of a network's episode must be below 2^32: got {seed}")
        from stable_baselines3.common.utils import set_random_seed

        from curricle.deep.models import isolated
        from curricle.deep.networks import acting

        drawn = replace(self.task, make=with_pictures(self.task.make))
        with closing(drawn.environment()) as env, isolated():
            set_random_seed(seed)
            act = acting(self.model, [env], sampled=not deterministic)
            # A number where it is one.
            return played(
                env, lambda observation: act(observation, [0])[()], seed=seed, limit=limit
            )

    def __repr__(self) -> str:
        return f"TrainedPolicy({type(self.model).__name__}, {self.task.make})"


@dataclass(frozen=True, eq=False, repr=False)
class DeepResult(LearningResult):
    """The result of :func:`learn_deep`: a :class:`LearningResult` with the learnt policies.

    Examples
    --------
    >>> from curricle import observation_task
    >>> ppo = DeepLearner("PPO", settings={"n_steps": 64})
    >>> result = learn_deep(observation_task("CartPole-v1"), ppo, 128, seeds=2, eval_freq=64)
    >>> result.policies
    (TrainedPolicy(PPO, CartPole-v1), TrainedPolicy(PPO, CartPole-v1))
    """

    @classmethod
    def of(cls, result: LearningResult) -> Self:
        """Return the result of networks with their policies."""
        return cls(**{field.name: getattr(result, field.name) for field in fields(result)})

    @cached_property
    def policies(self) -> tuple[TrainedPolicy, ...]:
        """The policy of each seed, K of them; SettingError where values were not saved."""
        task, learner, values = cast(Any, (self.task, self.learner, self.values))
        return policies_of(task, learner, values, self.steps_used)

    def parts_of_file(self) -> tuple[dict[str, Any], dict[str, Any]]:
        """Return the arrays and the plain JSON that :meth:`save` writes."""
        arrays, about = super().parts_of_file()
        offsets = [getattr(values, "values_offset", None) for values in self.values or ()]
        if all(offset is None for offset in offsets):
            return arrays, about
        task: Any = self.task
        phis = [_traits(task, offset).tolist() for offset in offsets]
        return arrays, about | {"shaped": phis}

    @classmethod
    def load(
        cls,
        path: str | Path,
        task: ObservationTask | None = None,
        learner: DeepLearner | None = None,
        shaping: Shaping | Sequence[Shaping | None] | None = None,
    ) -> Self:
        """Return the result in a file that :meth:`save` wrote; the networks are built again.

        The file holds their parameters as plain arrays, and no pickles. Without `task` and
        `learner` the values are these arrays.

        Parameters
        ----------
        path : path
        task : ObservationTask, optional
        learner : DeepLearner, optional
        shaping : Shaping or sequence of Shaping, optional
            The shaping they were trained with; one for each seed if it has a potential.

        Raises
        ------
        StoreError, SettingError
            When the file cannot be read, is damaged, or holds something else; when task, learner or
            shaping are not those that the networks were trained with.
        """
        saved = read_saved(path, cls.__name__)
        result = cls.of_file(saved, saved.arrays, saved.about, task)
        if learner is not None:
            instance("learner", learner, DeepLearner, SettingError)
            result = replace(result, learner=learner)  # type: ignore[arg-type]
        if task is None or learner is None or result.values is None:
            return result
        n = len(result.seeds)
        shapings = list(shaping) if isinstance(shaping, Sequence) else [shaping] * n
        if len(shapings) != n:
            raise SettingError(f"a shaping for each of {n} seeds is needed: got {len(shapings)}")
        learner.algorithm_class()  # raises ImportError that names what to install
        from curricle.deep.models import network_values

        shapings = [shaping and _of_observations(task, learner, shaping) for shaping in shapings]
        offsets = [of.potential if isinstance(of, StateShaping) else None for of in shapings]
        trained = saved.about.get("shaped", [[]] * n)
        for offset, saved_traits in zip(offsets, trained, strict=True):
            phi = _traits(task, offset)
            if len(phi) != len(saved_traits) or not np.allclose(phi, saved_traits, rtol=1e-3):
                raise SettingError(
                    "networks must be loaded with the StateShaping that they were trained with, "
                    f"and without any if they had none: got {shaping!r}"
                )
        try:
            values = tuple(
                network_values(task, learner, seed_shaping, parameters)
                for seed_shaping, parameters in zip(shapings, result.values, strict=True)
            )
        except (RuntimeError, KeyError) as error:
            raise SettingError(
                f"networks must be loaded with the task, learner and shaping they were trained "
                f"with: {learner} does not take these parameters, {' '.join(str(error).split())}"
            ) from None
        return replace(result, task=task, values=values)  # type: ignore[arg-type]


def _traits(task: ObservationTask, phi: ObservationPotential | None) -> FloatArray:
    """Return numbers by which a Phi is recognised; empty without one."""
    if phi is None:
        return np.empty(0)
    with closing(task.environment()) as environment:
        begun = [environment.reset(seed=k)[0] for k in range(8)]
    return np.asarray(phi.v(stack(task.observations, begun)))


def policies_of(
    task: ObservationTask,
    learner: DeepLearner,
    values: "Sequence[NetworkValues] | None",
    steps_used: IntArray,
) -> tuple[TrainedPolicy, ...]:
    """Return the policies of K :class:`NetworkValues`; SettingError for any other values."""
    if values is None or not all(hasattr(network, "policy") for network in values):
        raise SettingError(
            "policies need the values of networks: these "
            f"{'were not saved' if values is None else 'are their parameters alone, see load'}"
        )
    from curricle.deep.models import isolated, model_for  # needs torch

    policies = []
    for network, steps in zip(values, steps_used.tolist(), strict=True):
        potential = getattr(network.policy, "potential", None)
        shaping = None if potential is None else QInitialisation(potential)
        with isolated(learner.threads):
            model = model_for(task, learner, shaping, steps=max(steps, 1))
        model.env.close()
        model.env = None
        model.policy.load_state_dict(network.policy.state_dict())
        saved, _ = model._get_torch_save_params()
        for name in saved:  # "policy.optimizer", of SAC "actor.optimizer"
            if name.endswith(".optimizer"):
                reads = attrgetter(name.removeprefix("policy."))
                reads(model.policy).load_state_dict(reads(network.policy).state_dict())
        model.policy.set_training_mode(False)
        model.num_timesteps = steps
        policies.append(TrainedPolicy(task, model))
    return tuple(policies)


def policy_return(potential: Any, target: ObservationTarget, *, seed: int = 0) -> float:
    """Return a target's mean return by a potential's only source, an actor of its view, or NaN."""
    edges: Any = getattr(potential, "edges", ())
    sources: Any = getattr(potential, "values", ())
    source: Any = sources[0] if len(sources) == 1 and edges[0].mapping.is_identity else None
    if getattr(source, "kind", "") != "value_net":
        return float("nan")
    from curricle.deep.models import isolated  # needs torch, as what follows
    from curricle.deep.networks import acting

    start = splitmix64(stream_start(seed, "policy_return"))
    horizon = target.evaluation.horizon(target.task)
    environments = Environments(target.task, target.episodes, horizon)
    actor = acting(source.policy, environments.environments, sampled=target.evaluation.sampled)
    with closing(environments), isolated(seed=start):
        episodes = environments.rollouts(actor, start)
    return mean_episode_return(episodes, target.evaluation.discount(target.task))


# -- training -------------------------------------------------------------------------------------


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
    charged: Sequence[int] | IntArray | None = None,
    progress: Progress = None,
) -> DeepResult:
    """Train a deep learner in a task, seed after seed, and return the result of all seeds.

    Parameters
    ----------
    task : ObservationTask
    learner : DeepLearner
        By default DQN with the settings of Stable-Baselines3.
    budget : int, Episodes or StoppingRule
        As in :func:`learn`. A run ends at the first step of its sub-environments that reaches the
        budget; an algorithm does not learn from a rollout that this cuts off.
    seeds : int or sequence of int
        As in :func:`learn`; but results may differ with torch's version and the machine.
    shaping : Shaping or sequence of K Shaping, optional
        One for all seeds or one a seed, with an :class:`ObservationPotential` or ``ValueSource``:
        :class:`QInitialisation` or :class:`LookAheadAdvice` of DQN, :class:`StateShaping` of any
        algorithm, :class:`WeightTransfer` or :class:`PolicyReuse` of a source that is a network.
    eval_freq, stream, charged
        As in :func:`learn`.
    evaluation : GreedyEvaluation, optional
        By rollouts; 5 rollouts by default.
    progress : bool or callable, optional
        True shows a bar for each seed; a function is called with each seed at its end.

    Returns
    -------
    DeepResult
        A :class:`LearningResult` whose ``values`` are K :class:`NetworkValues`, with ``policies``.

    Raises
    ------
    SettingError, ImportError
        When an argument is invalid, or Stable-Baselines3 is not installed; before anything runs.

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
            "miniatures are solved and distilled as a task of a Curriculum, not learnt by "
            f"steps: got {task}"
        )
    check_spaces(task, learner)
    learner.algorithm_class()
    instance("evaluation", evaluation, GreedyEvaluation, SettingError)
    check_evaluation(evaluation)
    if evaluation.method != "off":
        evaluation.horizon(task)  # SettingError without a bound
    eval_freq = spacing(eval_freq, budget)
    longest = longest_run(task.longest, budget, eval_freq, learner.envs)
    settings = seed_settings(
        seeds,
        learner,
        limits(budget)[0],
        lambda shaping: _of_observations(task, learner, shaping),
        shaping=shaping,
        charged=charged,
    )
    if isinstance(budget, StoppingRule) and budget.fraction is not None:
        raise not_solved(budget.fraction, task)
    stopping, floor_steps = stopping_kernel(budget, task, evaluation, target_of)
    from curricle.deep.models import DeepRun  # needs Stable-Baselines3

    lengths = budget, eval_freq, longest
    run = DeepRun(task, learner, *lengths, evaluation, stopping, floor_steps, stream)
    outcomes = []
    with shown(progress) as bars:
        for of_seed in settings:
            name = f"{stream or 'learning'}, seed {of_seed.seed}"
            reached = bars.bar(name, longest // eval_freq + 1)
            outcomes.append(replace(run, reached=reached).train(*of_seed))
            bars.tell(of_seed.seed)
    numbers = tuple(of_seed.seed for of_seed in settings)
    values: Any = tuple(outcome.values for outcome in outcomes)
    result = learning_result(task, learner, numbers, values, outcomes, eval_freq)  # type: ignore[arg-type]
    return DeepResult.of(result)


def check_evaluation(evaluation: GreedyEvaluation) -> None:
    """Raise SettingError for an evaluation that needs tables."""
    if evaluation.method == "exact":
        raise SettingError(
            "networks must be evaluated by rollouts, since an exact evaluation needs tables: got "
            f"{evaluation}"
        )


def _of_observations(task: ObservationTask, learner: DeepLearner, shaping: Shaping) -> Shaping:
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
    of_states = shaping.starts_at_potential and not potential.of_actions
    if of_states and "buffer_size" in learner.takes:
        raise SettingError(
            f"{shaping.name} needs a potential of numbered actions; StateShaping does not"
        )
    return shaping.with_potential(potential)
