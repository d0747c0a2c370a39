"""Designers: legal curricula within the budget, the same for the same seeds, as published."""

from dataclasses import replace
from itertools import pairwise, permutations
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

import curricle as cr
from curricle import GridWorld, StoppingRule
from curricle.design import (
    TARGET,
    Problem,
    Recipe,
    Relation,
    SearchBudget,
    SourceCandidate,
    Stage,
    Training,
    source_candidates,
)
from curricle.design.designers import (
    DESIGNERS,
    ChainCosts,
    SourceSettings,
    beam,
    fixed_recipe,
    greedy_forward,
    growing_chain,
    hts_cr,
    object_oriented,
    objects_of,
    random_chain,
    svetlik,
    transfer_potential_of,
)
from curricle.design.designers.source_graphs import source_graph
from curricle.errors import CurriculumError
from curricle.learning.stopping import SETTLED
from curricle.tasks import FrozenLake, maze_family, pursuit_family
from tests.refusals import cases, check_refusal

MAZE = GridWorld(["S..P.", ".....", ".....", "....T"])
OPEN = GridWorld(["S.....", *["......"] * 4, ".....T"])
MAZES = source_candidates(MAZE, kinds=["crop", "removed", "starts"], most=5)
CROPS = source_candidates(OPEN, kinds=["crop"])
HUNT = pursuit_family(size=3, predators=2)
HUNTS = source_candidates(HUNT, kinds=["member"])
SEARCHES = ("greedy_forward", "beam", "hts_cr")
FEW = {name: {"seeds": 2} if name in SEARCHES else {} for name in DESIGNERS}


def maze():
    return Problem(MAZE, steps=1500), MAZES


def hunt():
    return Problem(HUNT, steps=1200, eval_freq=400), HUNTS


def candidate(name):
    """Return a source that differs from others by its name alone."""
    near = OPEN.crop(rows=(4, 6), columns=(4, 6))
    return SourceCandidate(name, near, cr.same_position(OPEN, near))


def told(names):
    """Return candidates of these names, whose costs only a test knows."""
    found = source_candidates(OPEN, kinds=[], propose=lambda _: [candidate(names[0])])
    return replace(found, candidates=tuple(map(candidate, names)))


class ToldCosts(SearchBudget):
    """A budget that pays for so many trainings, and answers what a test says that chains cost."""

    def __init__(self, costs, most=10**9):
        super().__init__(float("inf"))
        self.costs, self.most, self.trained = costs, most, []

    def train(self, problem, curriculum, seeds, *, placebo=False):
        if len(self.trained) == self.most:
            raise cr.design.BudgetSpent("no more")
        chain = curriculum.order[:-1]
        edges = [(one.source, one.target) for one in curriculum.transfers]
        assert edges == list(pairwise([*chain, TARGET]))
        self.trained.append(chain)
        steps = np.full(len(seeds), self.costs(chain))
        return Training(steps, np.ones(len(seeds), bool), np.zeros(len(seeds), int))


def described(curriculum):
    """Return all that a curriculum of a design is, as plain data."""
    nodes = [curriculum.node(name) for name in curriculum.order]
    edges = [
        (one.source, one.target, one.scale, one.mapping.index.tobytes())
        for one in curriculum.transfers
    ]
    return edges, [
        (one.name, str(one.budget), repr(one.shaping), one.aggregate.__name__, one.eval_freq)
        for one in nodes
    ]


def check_legal(curriculum, problem):
    assert curriculum.target == TARGET
    assert curriculum.tasks[TARGET] is problem.task
    assert set(curriculum.ancestors(TARGET)) == set(curriculum.order) - {TARGET}
    for name in curriculum.order[:-1]:
        assert isinstance(curriculum.setting("budget", name), StoppingRule)
    assert sum(curriculum.node(name).most_steps for name in curriculum.order[:-1]) < problem.steps


# -- what holds of each --------------------------------------------------------------------------


@pytest.mark.parametrize("made", [maze, hunt])
@pytest.mark.parametrize("name", DESIGNERS)
def test_a_design_is_legal_trains_and_is_the_same_again(name, made):
    problem, candidates = made()
    cost = 12 * problem.steps
    designs = []
    for _ in range(2):
        budget = SearchBudget(cost)
        found = DESIGNERS[name](problem, candidates, budget, seed=3, **FEW[name])
        check_legal(found, problem)
        assert budget.ledger.cost <= cost
        assert (budget.ledger.cost > 0) == (name in SEARCHES)
        trained, spent = problem.train(found, range(2))
        designs.append((described(found), trained.steps.tolist(), spent.steps))
    assert designs[0] == designs[1]


@pytest.mark.parametrize("made", [maze, hunt])
@pytest.mark.parametrize("name", DESIGNERS)
def test_without_a_budget_there_is_a_design_and_no_training(name, made):
    problem, candidates = made()
    budget = SearchBudget(0)
    found = DESIGNERS[name](problem, candidates, budget)
    check_legal(found, problem)
    assert budget.ledger.total_steps == 0
    if name in ("none", *SEARCHES):
        assert found.order == (TARGET,)


@settings(max_examples=30, deadline=None)
@given(
    name=st.sampled_from(SEARCHES),
    cost=st.integers(0, 40_000),
    seed=st.integers(0, 2**40),
    price=st.sampled_from([0.5, 1.0, 2.5]),
)
def test_a_search_never_spends_more_than_its_budget(name, cost, seed, price):
    problem, candidates = maze()
    budget = SearchBudget(cost, prices={"sources": price})
    found = DESIGNERS[name](problem, candidates, budget, seed=seed, seeds=2)
    check_legal(found, problem)
    assert budget.ledger.cost <= cost


@pytest.mark.parametrize("name", ["random", "object_oriented"])
def test_another_seed_draws_another_curriculum(name):
    problem, candidates = maze()
    designs = [DESIGNERS[name](problem, candidates, SearchBudget(0), seed=s) for s in range(8)]
    assert len({found.order for found in designs}) > 1


def test_the_package_offers_its_names_and_no_module_hides_one():
    package = cr.design.designers
    assert set(package.__all__) <= set(dir(package))
    assert {function.__name__ for function in DESIGNERS.values()} < set(package.__all__)
    modules = {path.stem for path in Path(package.__file__).parent.iterdir()}
    assert not modules & set(package.__all__)


# -- how sources are trained and read ------------------------------------------------------------


def test_sources_take_their_steps_by_states_and_at_most_their_share():
    problem = Problem(OPEN, steps=10_000)
    exact = SourceSettings(steps_per_state=20, share=0.1, settled=False)
    names = [one.name for one in CROPS][:2]
    costs = ChainCosts(problem, CROPS, SearchBudget(0), sources=exact)
    plan = costs.curriculum(tuple(names))
    for name in names:
        most = min(20 * CROPS[name].task.states.size, 500)
        assert plan.setting("budget", name) == StoppingRule(most)
    settled = SourceSettings(steps_per_state=20).budget(10, 1, 10_000)
    assert settled == StoppingRule(200, settled=SETTLED)


def test_a_total_counts_a_source_that_is_read_twice_as_one():
    problem, candidates = hunt()
    name = "pursuit(size=3, predators=1)"
    for aggregate, scale in (("total", 0.5), ("minimum", 1.0)):
        sources = SourceSettings(aggregate=aggregate)
        plan = ChainCosts(problem, candidates, SearchBudget(0), sources=sources).curriculum((name,))
        assert [one.scale for one in plan.transfers] == [scale, scale]
        assert plan.setting("aggregate", TARGET).__name__ == aggregate


def test_costs_are_means_over_the_same_seeds_and_each_chain_is_trained_once():
    problem, candidates = maze()
    name = next(iter(candidates)).name
    budget = SearchBudget(10**6)
    costs = ChainCosts(problem, candidates, budget, seed=5, seeds=3)
    assert len(set(costs.seeds)) == 3
    found = costs.of((name,))
    spent = budget.ledger.cost
    assert found == problem.train(costs.curriculum((name,)), costs.seeds)[0].steps.mean()
    assert costs.of((name,)) == found
    assert budget.ledger.cost == spent
    assert list(ChainCosts(problem, candidates, budget, seed=6).seeds) != list(costs.seeds)


def test_a_chain_that_cannot_be_read_costs_all_steps_and_is_neither_trained_nor_best():
    problem, candidates = hunt()
    impossible = "pursuit(size=2)", "pursuit(size=2, predators=1)"  # one predator reads no two
    budget = ToldCosts(lambda chain: problem.steps + 1)
    costs = ChainCosts(problem, candidates, budget)
    assert costs.of(impossible) == problem.steps
    assert costs.best == ()
    assert budget.trained == []


# -- by size -------------------------------------------------------------------------------------


def test_a_growing_chain_doubles_and_the_fixed_recipe_takes_the_half():
    problem = Problem(OPEN, steps=10_000)
    sizes = {one.name: one.relation.share for one in CROPS}
    assert {1 / 6, 2 / 6, 3 / 6, 4 / 6, 5 / 6} >= set(sizes.values())
    half = fixed_recipe(problem, CROPS, SearchBudget(0)).order[0]
    assert sizes[half] == 0.5
    large = fixed_recipe(problem, CROPS, SearchBudget(0), size=0.8).order[0]
    assert sizes[large] == 5 / 6
    chain = growing_chain(problem, CROPS, SearchBudget(0)).order[:-1]
    assert chain[-1] == half
    assert len(chain) == 2  # of 2 and 3 cells a side: 2 is the nearest to a quarter of 6
    for before, after in pairwise(chain):
        assert 2**0.5 <= sizes[after] / sizes[before] <= 2**1.5


def test_a_recipe_that_is_given_is_the_design():
    problem = Problem(OPEN, steps=10_000)
    recipe = Recipe([Stage(Relation("crop", 0.5), 40)], aggregate="minimum", scale=2.0)
    found = fixed_recipe(problem, CROPS, SearchBudget(0), recipe=recipe)
    assert described(found) == described(recipe.curriculum(OPEN, **problem.settings))


def test_a_random_chain_has_at_most_so_many_sources():
    problem, candidates = maze()
    for most in (1, 2, 9):
        lengths = {
            len(random_chain(problem, candidates, SearchBudget(0), seed=s, most=most).order) - 1
            for s in range(40)
        }
        assert lengths <= set(range(1, min(most, len(candidates)) + 1))
        assert {1, min(most, len(candidates))} <= lengths


# -- forward search ------------------------------------------------------------------------------


def test_greedy_takes_the_best_source_then_the_best_place_and_stops_where_none_is_better():
    costs = {"": 100, "c": 60, "ac": 50, "acb": 50, "acbd": 10}
    budget = ToldCosts(lambda chain: costs.get("".join(chain), 90))
    problem = Problem(OPEN, steps=1000)
    found = greedy_forward(problem, told("abcd"), budget)
    assert found.order == ("a", "c", TARGET)
    trained = ["".join(chain) for chain in budget.trained]
    assert trained[:5] == ["", "a", "b", "c", "d"]
    assert sorted(trained[5:11]) == ["ac", "bc", "ca", "cb", "cd", "dc"]
    assert sorted(trained[11:]) == ["abc", "acb", "acd", "adc", "bac", "dac"]


def test_a_beam_finds_a_pair_that_greedy_misses():
    costs = {("a",): 50, ("b",): 60, ("b", "c"): 10, ("c",): 70}
    problem = Problem(OPEN, steps=1000)
    plans = [
        search(problem, told("abc"), ToldCosts(lambda chain: costs.get(chain, 80)), **more).order
        for search, more in ((greedy_forward, {}), (beam, {"width": 2}))
    ]
    assert plans == [("a", TARGET), ("b", "c", TARGET)]


@pytest.mark.parametrize("search", [greedy_forward, hts_cr])
def test_a_search_whose_budget_ends_returns_the_best_so_far(search):
    problem, candidates = Problem(OPEN, steps=1000), told("abcd")
    for most in range(14):
        budget = ToldCosts(lambda chain: 1000 - 7 * len(str(chain)) - ord((*chain, "a")[0]), most)
        found = search(problem, candidates, budget).order[:-1]
        assert len(budget.trained) == most
        assert found == (min(budget.trained, key=budget.costs) if most else ())


def test_greedy_picks_the_source_that_is_best_by_measure_too():
    """A small part of a maze against two that are nearly as hard as the maze itself."""
    target = maze_family(size=8, pits=0.2, seed=1)
    problem = Problem(target, steps=20_000)
    found = source_candidates(target, kinds=["crop"])
    sides = {len(one.task.map): one for one in found}
    found = replace(found, candidates=(sides[7], sides[6], sides[3]))
    judge = ChainCosts(problem, found, SearchBudget(10**9), seed=99, seeds=20)
    best, *others = (judge.of((sides[side].name,)) for side in (3, 6, 7))
    assert best < 0.75 * min(others)
    for seed in range(3):
        chosen = greedy_forward(problem, found, SearchBudget(10**7), seed=seed).order[:-1]
        assert sides[3].name in chosen


# -- HTS-CR --------------------------------------------------------------------------------------


def naive_hts_cr(names, cost, longest):
    """Return the sets of chains that the authors' program evaluates, one after another."""
    pairs = [(a, b) for a in names for b in names if a != b]
    ranked = sorted(pairs, key=cost)
    head_score, tail_score = dict.fromkeys(names, 0), dict.fromkeys(names, 0)
    for score in range(len(ranked)):
        head_score[ranked[score][0]] += score + 1
        tail_score[ranked[score][-1]] += score + 1
    heads, tails = sorted(names, key=head_score.get), sorted(names, key=tail_score.get)
    known, stages, h, t = set(pairs), [], 1, 1
    for hyper in range(1, 2 * (len(names) - 1) + 1):
        if hyper % 2 == 1:
            h += 1
        else:
            t += 1
        for length in range(3, longest + 1):
            chains = set()
            for head in heads[:h]:
                for tail in tails[:t]:
                    if head == tail:
                        continue
                    left = (set(heads[:h]) | set(tails[:t])) - {head, tail}
                    chains |= {(head, *body, tail) for body in permutations(left, length - 2)}
            if chains - known:
                stages.append(chains - known)
            known |= chains
    return pairs, stages


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10**6), n=st.integers(2, 5), longest=st.integers(2, 5))
def test_hts_cr_evaluates_what_the_authors_program_does_in_its_order(seed, n, longest):
    names = "abcde"[:n]
    drawn = np.random.default_rng(seed).integers(1, 1000, size=10**4)

    def cost(chain):
        return int(drawn[int("".join(str(1 + names.index(one)) for one in chain)) % len(drawn)])

    budget = ToldCosts(cost)
    found = hts_cr(Problem(OPEN, steps=1000), told(names), budget, longest=longest)
    pairs, stages = naive_hts_cr(names, cost, longest)
    assert budget.trained[: len(pairs)] == pairs
    at = len(pairs)
    for stage in stages:
        assert set(budget.trained[at : at + len(stage)]) == stage
        at += len(stage)
    assert at == len(budget.trained)
    assert cost(found.order[:-1]) == min(map(cost, budget.trained))


def test_hts_cr_admits_heads_and_tails_in_turns_by_hand():
    """Pairs by cost: ac, ab, bc, cb, ba, ca; so heads a 3, b 8, c 10, tails c 4, b 6, a 11."""
    costs = {"ac": 1, "ab": 2, "bc": 3, "cb": 4, "ba": 5, "ca": 6}
    budget = ToldCosts(lambda chain: costs.get("".join(chain), 9))
    found = hts_cr(Problem(OPEN, steps=1000), told("abc"), budget)
    assert found.order == ("a", "c", TARGET)
    # Heads a, b and the tail c admit abc and bac; the tail b then acb; the head c all but those to
    # a, which is admitted last.
    chains = ["".join(one) for one in budget.trained[6:]]
    assert set(chains[:2]) == {"abc", "bac"}
    assert set(chains[2:4]) == {"acb", "cab"}
    assert set(chains[4:]) == {"bca", "cba"}


# -- graphs by transfer potential ----------------------------------------------------------------


def test_the_transfer_potential_by_hand():
    """Crops of k x k cells around the goal: k^2 - 1 states that are no end, of k^2."""
    for share, k in ((2 / 6, 2), (4 / 6, 4), (5 / 6, 5)):
        source = Relation("crop", share).source_of(OPEN)
        assert transfer_potential_of(OPEN, source) == (k * k - 1) / (1 + 36 - k * k)
    small, large = (Relation("crop", share).source_of(OPEN) for share in (2 / 6, 4 / 6))
    assert transfer_potential_of(OPEN, small, large) == 3 / (1 + 16 - 4)
    assert transfer_potential_of(OPEN, large, small) == 0


def edges_of(curriculum):
    return {(one.source, one.target) for one in curriculum.transfers}


def test_svetlik_within_a_group_by_hand():
    """Crops of 2 to 5 cells a side: .09, .29, .71, 2 for the target; .5, 1, 1.5 for the next."""
    problem = Problem(OPEN, steps=10_000)
    name = {len(one.task.map): one.name for one in CROPS}
    assert set(name) == {2, 3, 4, 5}
    found = svetlik(problem, CROPS, SearchBudget(0), threshold=0.4)
    assert edges_of(found) == {(name[4], name[5]), (name[5], TARGET)}
    found = svetlik(problem, CROPS, SearchBudget(0), threshold=0.08)
    chain = [name[k] for k in (2, 3, 4, 5)]
    assert edges_of(found) == set(pairwise([*chain, TARGET]))
    assert found.setting("aggregate", TARGET).__name__ == "total"
    assert found.setting("shaping", TARGET) == cr.LookAheadAdvice()
    assert svetlik(problem, CROPS, SearchBudget(0), threshold=5).order == (TARGET,)


def test_svetlik_between_groups_leads_from_fewer_objects_to_more():
    pit = GridWorld(["S.....", "...P..", *["......"] * 3, ".....T"])
    found = source_candidates(pit, kinds=["crop", "removed"])
    has = {one.name: "P" in {kind for kind, _ in objects_of(one.task, pit)} for one in found}
    plan = svetlik(Problem(pit, steps=5000), found, SearchBudget(0), threshold=0.05)
    assert set(has.values()) == {True, False}
    between = {edge for edge in edges_of(plan) if TARGET not in edge}
    assert any(not has[before] and has[after] for before, after in between)
    assert not any(has[before] and not has[after] for before, after in between)


def test_a_graph_links_the_best_above_the_threshold_and_what_leads_nowhere_to_the_target():
    names = dict(zip("abcd", map(candidate, "abcd"), strict=True))
    table = {("a", None): 3, ("b", None): 2, ("c", None): 4, ("d", None): 1}
    table |= {("b", "a"): 5, ("c", "a"): 1.5, ("b", "c"): 1, ("d", "a"): 9}
    groups = {"a": frozenset("xy"), "b": frozenset("xy"), "c": frozenset("x")}

    def potential(source, task, _):
        return table.get((source.name, None if task is None else task.name), 0)

    kept, edges = source_graph(list(names.values()), potential, lambda one: groups[one.name], 1.0)
    assert [one.name for one in kept] == ["a", "b", "c"]  # d is at the threshold, not above it
    assert set(edges) == {("b", "a"), ("c", "a"), ("a", TARGET)}


def test_own_objects_replace_those_of_the_map():
    problem = Problem(OPEN, steps=10_000)
    name = {len(one.task.map): one.name for one in CROPS}

    def sides(task):
        return [("side", i) for i in range(len(task.map))] + [(str(len(task.map)), 0)]

    # Each size is a class of its own, and no class a subset of another: nothing is linked.
    plan = svetlik(problem, CROPS, SearchBudget(0), threshold=0.4, objects=sides)
    assert edges_of(plan) == {(name[4], TARGET), (name[5], TARGET)}


def test_the_objects_of_a_task():
    lake = FrozenLake(["SFFF", "FHFH", "FFFH", "HFFG"])
    assert {kind for kind, _ in objects_of(lake)} == {"H", "G", "row", "column"}
    part = lake.crop(rows=(2, 4), columns=(2, 4))
    assert {one for one in objects_of(part, lake) if one[0] in "HG"} == {
        ("H", (2, 3)),
        ("G", (3, 3)),
    }
    assert {kind for kind, _ in objects_of(HUNT.task)} == {"prey", "predator"}


def test_the_object_oriented_potential_by_hand():
    """A crop of 2 x 2 has T, row and column of T, P, row and column, and 3 of 20 states.

    sim = 3 + 3 / 20; its potential is sim (20 x 5) / (4 x 4) = 19.7.
    """
    crop = Relation("crop", 0.4).source_of(MAZE)
    assert crop.task.states.size == 4
    found = replace(MAZES, candidates=(crop,))
    problem = Problem(MAZE, steps=2000)
    potential = (3 + 3 / 20) * (20 * 5) / (4 * 4)
    for threshold, sources in ((potential - 1e-9, {crop.name}), (potential + 1e-9, set())):
        plan = object_oriented(problem, found, SearchBudget(0), threshold=threshold)
        assert set(plan.order) - {TARGET} == sources


def test_object_oriented_drops_what_repeats_a_source_that_it_has():
    """Crops of 2 and 3 cells a side, worth 19.7 and 9.4 alone, and 5.9 and 2.5 after the other."""
    crops = tuple(Relation("crop", share).source_of(MAZE) for share in (0.4, 0.6))
    assert [one.task.states.size for one in crops] == [4, 9]
    found, problem = replace(MAZES, candidates=crops), Problem(MAZE, steps=2000)
    for threshold, left in ((2.0, 2), (8.0, 1), (20.0, 0)):
        for seed in range(5):
            settings = {"seed": seed, "threshold": threshold}
            plan = object_oriented(problem, found, SearchBudget(0), **settings)
            assert len(plan.order) - 1 == left


# -- refusals ------------------------------------------------------------------------------------


def design(name, **settings):
    problem, candidates = maze()
    given = {"problem": problem, "candidates": candidates, "budget": SearchBudget(0)}
    return DESIGNERS[name](**given | settings)


@pytest.mark.parametrize("name", DESIGNERS)
@pytest.mark.parametrize(
    ("setting", "says"),
    [
        ({"problem": MAZE}, "problem of a design must be a Problem"),
        ({"candidates": [1]}, "candidates of a design must be a SourceCandidates"),
        ({"candidates": CROPS}, "candidates must be for the target of the problem"),
        ({"budget": 1000}, "budget of a design must be a SearchBudget"),
        ({"seed": -1}, "seed of a design must be a whole number"),
    ],
)
def test_what_every_designer_refuses(name, setting, says):
    check_refusal(CurriculumError, lambda: design(name, **setting), says)


REFUSED = {
    CurriculumError: {
        "most": (lambda: design("random", most=0), "sources of a random chain"),
        "size": (lambda: design("fixed_recipe", size=1.5), "between 0 and 1: got 1.5"),
        "recipe": (lambda: design("fixed_recipe", recipe="half"), "recipe of a design must be"),
        "factor": (lambda: design("growing_chain", factor=1), "above 1: got 1"),
        "kind": (lambda: design("growing_chain", kind="member"), "kind of a growing chain"),
        "threshold": (lambda: design("svetlik", threshold=-1), "threshold of transfer potentials"),
        "repetitions": (lambda: design("object_oriented", repetitions=0), "repetitions of the"),
        "objects": (lambda: design("svetlik", objects="pits"), "objects must be a function"),
        "pairs": (lambda: design("object_oriented", objects=lambda _: "pit"), "must be pairs"),
        "numbers": (lambda: design("svetlik", objects=lambda _: [(1, 2)]), "a class in words"),
        "width": (lambda: design("beam", width=0), "width of a beam"),
        "seeds": (lambda: design("greedy_forward", seeds=0), "seeds of a training of a search"),
        "longest": (lambda: design("hts_cr", longest=1), "longest chain of a search"),
        "sources": (lambda: design("random", sources=3), "sources of a design must be"),
        "steps": (lambda: SourceSettings(steps_per_state=0), "steps per state .* above 0"),
        "share": (lambda: SourceSettings(share=1), "share .* between 0 and 1"),
        "settled": (lambda: SourceSettings(settled=1), "settled of sources must be a bool"),
        "aggregate": (lambda: SourceSettings(aggregate="sum"), "aggregate of sources"),
        "shaping": (lambda: SourceSettings(shaping="bonus"), "shaping by sources"),
    }
}


@pytest.mark.parametrize(("error", "call", "says"), cases(REFUSED))
def test_settings_that_make_no_sense(error, call, says):
    check_refusal(error, call, says)
