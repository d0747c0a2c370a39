"""Recipes: sources in relative terms, and the curricula that they make of a target."""

import numpy as np
import pytest

import curricle as cr
from curricle import GridWorld
from curricle.design import Recipe, Relation, Stage, Trend
from curricle.design.assembly import TARGET, transfers_of
from curricle.design.between_sources import mappings_between
from curricle.design.recipe import AGGREGATES, SHAPINGS
from curricle.errors import CurriculumError
from curricle.tasks import maze_family, pursuit_family
from tests.refusals import cases, check_refusal

MAZE = GridWorld(["S....", ".#.P.", ".....", ".P.#.", "....T"])
HUNT = pursuit_family(size=4, predators=2)


def crops(*shares, steps=10, **settings):
    return Recipe([Stage(Relation("crop", share), steps) for share in shares], **settings)


# -- relations -----------------------------------------------------------------------------------


def test_a_candidate_says_how_it_relates_to_its_target_and_is_found_again_by_that():
    for target in (MAZE, maze_family(size=8, pits=0.2, seed=1), HUNT):
        again = 0
        for one in cr.design.source_candidates(target, most=40):
            if one.relation is not None and one.kind != "bottleneck":
                assert one.relation.source_of(target).name == one.name
                again += 1
        assert again > 3


def test_a_relation_holds_for_other_targets():
    half = Relation("member", changes={"size": "0.5 n", "predators": "n - 1"})
    names = [half.source_of(pursuit_family(size=n, predators=p)).name for n, p in ((6, 3), (9, 2))]
    assert names == ["pursuit(size=3)", "pursuit(size=5, predators=1)"]  # 4.5 is rounded up
    part = Relation("crop", 0.5)
    assert part.source_of(maze_family(size=8, seed=1)).task.map[0].__len__() == 4
    assert part.source_of(maze_family(size=12, seed=1)).task.map[0].__len__() == 6


def test_of_two_parts_that_are_equally_near_the_larger_is_taken():
    maze = GridWorld(["S" + 9 * "."] + 8 * [10 * "."] + [9 * "." + "T"])
    assert len(Relation("crop", 0.35).source_of(maze).task.map) == 4


def test_values_stay_within_the_limits_of_a_parameter():
    tiny = Relation("member", changes={"size": "0.1 n"})
    assert tiny.source_of(maze_family(size=6, seed=1)).name.startswith("maze(size=2")


@pytest.mark.parametrize(
    ("error", "call", "says"),
    cases({
        CurriculumError: {
            "kind": (lambda: Relation("corner", 0.5), "the kind of a relation must be one of"),
            "share": (lambda: Relation("crop", 1.5), "must lie between 0 and 1: got 1.5"),
            "no changes": (lambda: Relation("member"), "a member needs them"),
            "changes": (lambda: Relation("crop", changes={"size": 3}), "got the kind 'crop' with"),
            "a list": (
                lambda: Relation("member", changes={"size": [3, 4]}),
                r"size in the changes of a relation must be one value, .*: got \[3, 4\]",
            ),
            "settled": (
                lambda: Stage(Relation("crop", 0.5), 3, settled="no"), "settled of a stage must be"
            ),
            "one stage": (
                lambda: Recipe(Stage(Relation("crop", 0.5), 3)),
                "the stages of a recipe must be a list of Stages: got Stage",
            ),
            "scales": (lambda: Recipe(scale=np.ones(2)), "a number of a recipe must be a number"),
            "flat draws": (lambda: Trend(1.0, draws=[1, 2]), "must be pairs of level and slope"),
            "draws": (lambda: Trend(1.0, draws=[(-1, 2)]), "their levels above 0: got"),
            "beyond a float": (
                lambda: Trend(1.0, slope=900.0).at(10), "finite and above 0: .* at 10 states"
            ),
            "no dict": (lambda: Relation("member", changes=3), "must be a dict of parameters"),
            "no member": (
                lambda: Relation("member", changes={"size": 3}).source_of(MAZE),
                "needs a target that is a member of a family",
            ),
            "no such": (
                lambda: Relation("removed", which="no fire").source_of(MAZE),
                "has no source that is a removed: no fire",
            ),
            "shaping": (lambda: crops(0.5, shaping="both"), "the shaping of a recipe must be"),
            "aggregate": (lambda: crops(0.5, aggregate="sum"), "the aggregate of a recipe must"),
            "stage": (lambda: Recipe(["crop"]), "each stage of a recipe must be"),
            "level": (lambda: crops(0.5, steps=0), "level of a trend must be above 0: got 0"),
            "edge": (
                lambda: list(transfers_of(MAZE, [], [("a", TARGET)])),
                "an edge must lead from a source",
            ),
        }
    })
)  # fmt: skip
def test_what_makes_no_recipe_is_refused(error, call, says):
    check_refusal(error, call, says)


# -- curricula -----------------------------------------------------------------------------------


def test_a_chain_builds_each_source_on_the_one_before():
    plan = crops(0.4, 0.8).curriculum(MAZE, budget=1000)
    small, large, target = plan.order
    assert [(one.source, one.target) for one in plan.transfers] == [(small, large), (large, target)]
    star = crops(0.4, 0.8, chain=False).curriculum(MAZE, budget=1000)
    assert {one.target for one in star.transfers} == {TARGET}


def test_budgets_are_exact_and_grow_with_the_target():
    recipe = crops(0.5, steps=Trend(10.0, slope=1.0, around=16.0))
    for size in (4, 8):
        maze = maze_family(size=size, walls=0.0, seed=1)
        plan = recipe.curriculum(maze, budget=10_000)
        states = plan.tasks[plan.order[0]].states.size
        steps = round(states * 10.0 * maze.task.states.size / 16.0)
        assert plan.node(plan.order[0]).budget == cr.StoppingRule(steps)
        assert (plan.train(seeds=2).source_steps(TARGET) == steps).all()


def test_scale_aggregate_and_shaping_are_those_of_the_transfers_into_the_target():
    relation = Relation("member", changes={"predators": 1})
    for aggregate in AGGREGATES:
        recipe = Recipe([Stage(relation, 5)], aggregate=aggregate, scale=3.0)
        plan = recipe.curriculum(HUNT, budget=1000)
        assert [one.scale for one in plan.transfers] == [3.0, 3.0]
        assert plan.node(TARGET).aggregate is AGGREGATES[aggregate]
    for shaping, make in SHAPINGS.items():
        plan = crops(0.4, 0.8, shaping=shaping).curriculum(MAZE, budget=1000)
        assert plan.node(TARGET).shaping == make()
    assert crops(0.5, scale="calibrated").curriculum(MAZE).calibration(TARGET) is not None


def test_annealed_sources_have_a_learner_of_their_own():
    plan = crops(0.4, 0.8, annealed=True).curriculum(MAZE, budget=500, learner=cr.SARSA())
    small, _, _ = plan.order
    assert isinstance(plan.node(TARGET).learner, cr.SARSA)
    assert plan.node(small).learner.epsilon == 0.5


def test_sources_that_are_the_target_or_alike_are_left_out():
    maze = GridWorld(["S.", ".T"])
    assert [one.name for _, one in crops(0.5).sources(GridWorld(["S..", "...", "..T"]))]
    with pytest.raises(CurriculumError, match="has no source that is a crop"):
        crops(0.5).sources(maze)
    assert len(crops(0.4, 0.41, 0.8).sources(MAZE)) == 2


def test_without_stages_the_target_is_learnt_alone():
    plan = Recipe().curriculum(MAZE, budget=1000)
    assert plan.order == (TARGET,)
    assert str(Recipe()) == "no curriculum: the target is learnt alone"


# -- how sources read each other -----------------------------------------------------------------


@pytest.mark.parametrize("shares", [(0.4, 0.8), (0.4, 0.6), (0.6, 0.8)])
def test_one_part_reads_another_as_its_own_mapping_says(shares):
    small, large = (Relation("crop", share).source_of(MAZE) for share in shares)
    (found,) = mappings_between(MAZE, large, small)
    direct = cr.same_position(large.task, small.task)
    alive = ~large.task.mdp.terminal
    np.testing.assert_array_equal(found.index[alive], direct.index[alive])


def test_members_read_each_other_as_their_family_says():
    target = pursuit_family(size=4, predators=3)
    two, one = (Relation("member", changes={"predators": p}).source_of(target) for p in (2, 1))
    found = mappings_between(target.task, two, one)
    expected = cr.transfer.family_mappings(two.member, one.member)
    assert [each.index.tolist() for each in found] == [each.index.tolist() for each in expected]


def test_through_the_target_only_mappings_that_agree_are_taken():
    target = cr.Pursuit(3, predators=3)
    two, one = (Relation("removed", which=f"{n} predator{'s' * (n > 1)}") for n in (2, 1))
    found = mappings_between(target, two.source_of(target), one.source_of(target))
    assert len(found) == 2  # of the two predators that the later source has


# -- trends --------------------------------------------------------------------------------------


def test_a_trend_has_the_percentiles_of_its_resamples():
    levels = np.linspace(1.0, 3.0, 201)
    trend = Trend(2.0, slope=0.5, around=100.0, draws=np.stack([levels, levels * 0 + 0.5], 1))
    low, high = trend.interval(400.0)
    assert trend.at(400.0) == pytest.approx(4.0)
    assert (low, high) == pytest.approx((2.1, 5.9))
    assert np.isnan(Trend.constant(3.0).interval(10)).all()
