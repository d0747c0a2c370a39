"""Small relatives, solved, as a source for networks."""

from dataclasses import replace
from functools import partial

import gymnasium
import numpy as np
import pytest
from gymnasium.spaces import Box

import curricle as cr
from curricle.curriculum.curriculum import PULL
from curricle.deep import DeepLearner, PolicyReuse, WeightTransfer, miniatures

PPO = DeepLearner(
    "PPO", envs=2, settings={"n_steps": 32, "batch_size": 32, "policy_kwargs": {"net_arch": [32]}}
)
ROLLOUTS = cr.GreedyEvaluation(episodes=3)


class Room(gymnasium.Env):
    """A room in which the way to the goal is seen; start and goal are drawn at each reset."""

    observation_space = Box(-1, 1, (2,), np.float32)
    action_space = gymnasium.spaces.Discrete(4)
    moves = np.array([[0, 1], [1, 0], [0, -1], [-1, 0]])

    def __init__(self, size=4, blind=False):
        self.size, self.blind = size, blind

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.goal = self.np_random.integers(0, self.size, 2)
        self.place = (self.goal + self.np_random.integers(1, self.size, 2)) % self.size
        return self.seen(), {}

    def step(self, action):
        self.place = np.clip(self.place + self.moves[int(action)], 0, self.size - 1)
        there = bool((self.place == self.goal).all())
        return self.seen(), float(there), there, False, {}

    def seen(self):
        way = (self.goal - self.place) / 10
        return np.zeros(2, np.float32) if self.blind else way.astype(np.float32)


def room(size=4, discount=0.9, **settings):
    return cr.observation_task(partial(Room, size, **settings), discount=discount, time_limit=30)


def plan(shaping, *, small=None, learner=PPO, budget=192, **settings):
    relatives = miniatures(room(), resets=6) if small is None else small
    return cr.Curriculum(
        {"small": relatives, "large": room(8)}, [cr.Transfer("small", "large")],
        learner={"large": learner}, budget={"large": budget}, eval_freq=64,
        evaluation=ROLLOUTS, shaping=shaping, **settings,
    )  # fmt: skip


def test_an_actor_critic_starts_as_what_was_distilled_unless_told_otherwise():
    def shaping(learner, **settings):
        return plan(None, learner=learner, **settings).node("large").shaping

    kept_near = cr.deep.WeightTransfer(kl=PULL)
    assert shaping(PPO) == kept_near
    assert shaping(PPO, budget=cr.Episodes(3)) == kept_near
    assert shaping(cr.deep.DeepLearner("DQN")) == cr.QInitialisation()
    normal = cr.deep.DeepLearner("DQN", settings={"normalize": True})  # its values have a scale
    assert shaping(normal) == cr.StateShaping()
    other = cr.deep.DeepLearner("A2C")
    apart = plan(None).replace("large", learner=other)
    assert apart.node("large").shaping == cr.StateShaping()
    learnt = {"small": room(), "large": room(8)}
    by_steps = cr.Curriculum(learnt, [cr.Transfer("small", "large")], learner=PPO, budget=64)
    assert by_steps.node("large").shaping == cr.StateShaping()
    result = plan(None).train(1)["large"]
    assert np.isfinite(result.greedy_return).all()


def test_levels_are_what_a_reset_can_reach_and_some_are_held_out():
    small = miniatures(room(), resets=40, held_out=0.25)
    (member,) = small.solved
    goals = {goal_of(seed) for seed in range(40)}
    assert member.levels == len(goals)
    starts = np.flatnonzero(member.table.mdp.start)
    held = {member.level[state] for state in starts if not member.training[state]}
    assert len(held) == round(0.25 * member.levels)
    known = small.knowledge()
    assert known.states.sum() == member.training.sum()


def goal_of(seed):
    env = Room(4)
    env.reset(seed=seed)
    return tuple(env.goal.tolist())


def test_what_is_distilled_is_exact():
    small = miniatures(room(), resets=40, held_out=0.0)
    known = small.knowledge()
    steps = np.abs(np.rint(10 * known.observations)).sum(axis=1)
    assert known.values == pytest.approx(0.9 ** (steps - 1))


@pytest.mark.parametrize("charged", [0, 3])
def test_its_models_are_charged_and_its_network_acts_well_on_other_levels(charged):
    small = miniatures(room(), resets=40, tested_on=[room(6)], charged=charged)
    result = plan(PolicyReuse(), small=small).train(seeds=2)
    (member,) = small.solved
    states = int((~member.table.mdp.terminal).sum())
    assert small.transitions == states * 4
    assert result.source_steps("large").tolist() == [charged * states * 4] * 2
    assert (result["small"].greedy_return > 0.5).all()
    exam, _ = small.examined(result["small"].values[0])
    assert exam.optimal >= exam.greedy > exam.random
    assert 0.5 < exam.regained <= 1.0 + 1e-9


@pytest.mark.parametrize("charged", [0, 3])
def test_a_comparison_charges_the_models_once_and_has_a_placebo(charged):
    small = miniatures(room(), resets=6, charged=charged)
    with_placebo = {"controls": ["placebo"], "threshold": 0.3, "window": 1}
    comparison = cr.compare(plan(PolicyReuse(), small=small), seeds=3, **with_placebo)
    assert list(comparison.arms) == ["scratch", "transfer", "transfer, placebo"]
    spent = small.transitions * charged
    assert comparison.total == 192 + -(-spent // 64) * 64
    for name, arm in comparison.arms.items():
        assert (arm.curve.source_steps == spent * (name != "scratch")).all()
        x, alone = arm.curve.steps, comparison.scratch.curve.values
        late = [np.interp(x - spent * (name != "scratch"), x, row) for row in arm.curve.values]
        begun = x >= arm.curve.source_steps[0]  # its first return comes after the models' steps
        values = arm.charged(comparison.scratch).values
        assert values[:, begun] == pytest.approx(np.array(late)[:, begun])
        assert (values[:, ~begun] <= alone[:, :1]).all()
    assert comparison.arms["transfer, placebo"].control


def test_a_forecast_says_what_holds_on_held_out_levels():
    small = miniatures(room(), resets=40, tested_on=[room(6)])
    foreseen = cr.forecast(plan(PolicyReuse(), small=small), seeds=2, trial=False)
    distilled = foreseen.sources["small"]
    assert distilled.shares.shape == (2, 2)
    assert 0.5 < distilled.shares[:, -1].mean() <= 1.0 + 1e-9
    assert "held-out levels of " in str(distilled)
    assert "training level" not in str(distilled)
    assert 0 <= foreseen.start.potential <= 1
    shares, returned = str(foreseen.text(10_000)).splitlines()[2:4]
    assert shares.endswith(", which alone says little of 'large'")
    assert returned.startswith("the potential's own policy returns ")
    assert " in 'large', from 2 seeds of small (" in returned


@pytest.mark.parametrize(
    ("settings", "kind"),
    [({"resets": 1}, "training level"), ({"resets": 8, "held_out": 0.0}, "training level"),
     ({"resets": 8, "held_out": 0.3}, "held-out level")],
)  # fmt: skip
def test_levels_that_were_trained_on_are_not_said_to_be_held_out(settings, kind):
    small = miniatures(room(), tested_on=[room(5)], **settings)
    result = cr.Curriculum({"small": small}, [], learner=PPO).train(1)["small"]
    exam, other = small.examined(result.values[0])
    assert (exam.kind, other.kind) == (kind, "held-out level")
    (member,) = small.solved
    apart = ~member.training & ~member.table.mdp.terminal
    assert apart.any() == (kind == "held-out level")
    assert exam.levels == len(np.unique(member.level[apart if apart.any() else member.training]))
    assert other.levels > 0


DQN = DeepLearner("DQN", envs=2, settings={"learning_starts": 10})
SIDEWAYS = np.array([3, 2, 1, 0])


def mapped(shaping, learner, **mapping):
    curriculum = plan(shaping)
    small, large = curriculum.tasks["small"], curriculum.tasks["large"]
    edge = cr.Transfer("small", "large", cr.transfer.ObservationMapping(large, small, **mapping))
    return replace(curriculum, transfers=[edge], learner={"large": learner, "small": learner})


@pytest.mark.parametrize("held_out", [0.5, 0.9])
@pytest.mark.parametrize("resets", [1, 2, 4])
def test_a_level_of_each_member_is_left_to_be_distilled(resets, held_out):
    (member,) = miniatures(room(), resets=resets, held_out=held_out).solved
    assert member.training.any()
    assert member.levels == 1 or not member.training[~member.table.mdp.terminal].all()


def test_a_guide_with_action_values_is_read_through_its_mapping():
    result = mapped(PolicyReuse(), DQN, actions=SIDEWAYS).train(1)
    (phi,) = result.potentials["large"]
    seen = np.array([[0.3, 0.0], [0.0, -0.3]], np.float32)
    of_policy = result["small"].values[0].policy.predict(seen, deterministic=True)[0]
    assert phi.pairs(seen).argmax(axis=1).tolist() == SIDEWAYS[of_policy].tolist()


STUDY = """
name = "rooms"
seeds = 1
seeds_per_unit = 1
[learner]
type = "deep"
algorithm = "PPO"
envs = 2
settings = { n_steps = 32, batch_size = 32, policy_kwargs = { net_arch = [32] } }
[tasks.small]
type = "distilled"
members = [{ factory = "rooms:room", arguments = { size = 4 } }]
tested_on = [{ factory = "rooms:room", arguments = { size = 5 } }]
discount = 0.9
resets = 6
[tasks.large]
type = "observation_task"
factory = "rooms:room"
arguments = { size = 8 }
discount = 0.9
budget = 128
eval_freq = 64
evaluation = { episodes = 3 }
[[transfers]]
source = "small"
target = "large"
mapping = "identity"
[arms.distilled]
[arms.placebo]
tasks.small.shuffled = true
"""


def test_a_study_distils_and_is_stored(tmp_path):
    (tmp_path / "rooms.py").write_text(
        "import gymnasium\n"
        "from tests.deep.test_miniatures import Room\n"
        "def room(size):\n"
        "    return gymnasium.wrappers.TimeLimit(Room(size), 30)\n"
    )
    (tmp_path / "study.toml").write_text(STUDY)
    study = cr.study.read_study(tmp_path / "study.toml")
    plan = study.curricula["distilled"]
    (member,) = plan.tasks["small"].members
    assert str(member.make).endswith("rooms:room(size=4)")
    out = tmp_path / "results"
    cr.study.run_study(study, out)
    results = cr.study.StudyResults(out)
    assert not results.failed
    for arm in ("scratch", "distilled", "placebo"):
        assert np.isfinite(results.result(arm, "large").greedy_return).all()
    assert results.comparison.budget == 128 < results.result("distilled", "large").steps_used
    small = results.result("distilled", "small", values=True)
    spent = plan.tasks["small"].transitions
    assert small.steps_used.tolist() == [spent] == results.source_steps("distilled").tolist()
    alone = plan.train([0], only="small")["small"]
    for stored, trained in zip(small.values, alone.values, strict=True):
        parameters = trained.parameters()
        assert all((stored[name] == parameters[name]).all() for name in parameters)
    assert results.source_steps("placebo").tolist() == [spent]


def with_a_source():
    whole = plan(None)
    chain = [cr.Transfer("first", "small"), *whole.transfers]
    return replace(whole, tasks={"first": miniatures(room(3)), **whole.tasks}, transfers=chain)


BAD = {
    "solved and need no source: .*'first'": with_a_source,
    "at least one member": miniatures,
    "one space": lambda: miniatures(room(), cr.observation_task("CartPole-v1")),
    "numbered actions": lambda: miniatures(cr.observation_task("Pendulum-v1")),
    "one discount": lambda: miniatures(room(), room(5, 0.5)),
    "miniature CartPole-v1 has no tables.*max_states": lambda: (
        miniatures(cr.observation_task("CartPole-v1"), resets=1, max_states=50).solved
    ),
    "not learnt by steps": lambda: cr.deep.learn_deep(miniatures(room()), PPO, 64),
    "better than at random": lambda: plan(
        PolicyReuse(), small=miniatures(room(blind=True), resets=20)
    ).train(1),
    r"'small' has .*actions as 3 2 1 0": lambda: mapped(
        WeightTransfer(), PPO, actions=SIDEWAYS
    ).train(1),
    r"PolicyReuse needs a mapping .*'small' has .*actions as 3 2 1 0": lambda: mapped(
        PolicyReuse(), PPO, actions=SIDEWAYS
    ).train(1),
}


@pytest.mark.parametrize("said", BAD)
def test_what_is_bad_is_refused_in_a_sentence(said):
    kinds = cr.errors.TaskError, cr.errors.SettingError, cr.errors.CurriculumError
    with pytest.raises(kinds, match=said) as caught:
        BAD[said]()
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("learner", [DQN, DeepLearner("TRPO")], ids=str)
def test_what_a_learner_does_not_take_is_said_before_miniatures_are_solved(learner):
    pytest.importorskip("sb3_contrib")
    small = miniatures(room(), resets=6)
    with pytest.raises(cr.errors.SettingError):
        plan(WeightTransfer(kl=0.1), learner=learner, small=small).train(1)
    assert "solved" not in vars(small)
