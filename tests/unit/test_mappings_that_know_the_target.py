"""A mapping that was found in the target's model: it says so, wherever it is used."""

import re
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

import curricle as cr
from benchmarks.unrelated_pairs import SEARCHED, unrelated
from curricle import Transfer
from curricle.comparison import compare
from curricle.comparison.controls import DRAWS, unrelated_transfers
from curricle.comparison.sentences import findings
from curricle.comparison.trial import apart
from curricle.comparison.verdicts import NO_MORE
from curricle.errors import CurriculumError, MappingError
from curricle.study import StudyResults, read_study
from curricle.tasks.mdp import tables
from curricle.transfer import (
    auto_mapping,
    find_mappings,
    identity,
    score_mapping,
)
from curricle.transfer.by_components import ComponentMapping
from curricle.transfer.search import MOST_APART, SEARCHES
from curricle.transfer.transfer import FOUND, transfer_words
from tests.support.comparisons import copied, corner, of_arms
from tests.unit.test_found_mapping_studies import STUDY
from tests.unit.test_found_mappings import CROP, MAZE, MIRRORED
from tests.unit.test_resuming import again
from tests.unit.test_verdicts import NOISE, controlled, flat

HUNT, CHASE = cr.Pursuit(3, 2), cr.Pursuit(3, 1)


def auto(target=MAZE, source=MIRRORED, mapping=None, **settings):
    """Return a curriculum whose mapping is found unless it is given."""
    tasks = {"source": source, "target": target}
    budget = {"source": 200, "target": 2000}
    return cr.Curriculum(
        tasks, [Transfer("source", "target", mapping)], **{"budget": budget, **settings}
    )


def test_what_a_search_found_knows_the_target_and_what_a_hand_made_does_not():
    for source in (MIRRORED, CROP):
        assert all(one.mapping.knows_target for one in find_mappings(MAZE, source))
    of_names = find_mappings(MAZE, CROP, searches=SEARCHES[:1])[0].mapping  # chosen by its values
    assert (isinstance(of_names, ComponentMapping), of_names.knows_target) == (True, True)
    by_hand = cr.project(HUNT, CHASE, predator="predator_1"), cr.same_position(MAZE, CROP)
    assert not any(mapping.knows_target for mapping in (*by_hand, identity(MAZE)))
    member = cr.tasks.pursuit_family
    mappings = cr.transfer.family_mappings(member(size=3, predators=2), member(size=3, predators=1))
    assert not any(mapping.knows_target for mapping in mappings)


def test_a_copy_between_does_not_hide_it():
    copy = tables(MAZE)
    edges = [Transfer("source", "copy"), Transfer("copy", "target", identity(MAZE, copy))]
    tasks = {"source": MIRRORED, "copy": copy, "target": MAZE}
    assert cr.Curriculum(tasks, edges, budget=100).knows_target("target")


def test_a_smaller_task_between_may_be_known():
    line, half, end = (cr.GridWorld("S" + "." * n + "T") for n in (8, 4, 3))
    carried = cr.transfer.from_function(
        line, half, lambda s, a: ({"row": s["row"], "column": s["column"] // 2}, a)
    )
    edges = [Transfer("end", "half"), Transfer("half", "line", carried)]
    plan = cr.Curriculum({"end": end, "half": half, "line": line}, edges, budget=100)
    assert (plan.knows_target("half"), plan.knows_target("line")) == (True, False)


def test_what_a_curriculum_is_turned_into_keeps_it():
    plan = auto()
    for same in (apart(plan), replace(plan, budget=100)):
        assert same.knows_target(same.target)
    assert not auto(mapping=identity(MAZE, MIRRORED)).knows_target("target")
    assert FOUND in transfer_words(plan.transfers[0])


def test_it_stands_in_the_verdict_whatever_the_verdict_is():
    for pays, constant, reason in (
        (10.0, 4.0, "by its source or by the search for its mapping, "),
        (0.0, 0.0, ""),
        (-3.0, -5.0, ""),
    ):
        comparison = controlled(pays, constant, placebo=constant)
        arms = {**comparison.arms, "mean": replace(comparison["mean"], knows_target=True)}
        known = of_arms(arms)
        assert known.contrasts["mean"].reason == f"{reason}{FOUND}"
        assert "by what it knows" not in known.contrasts["mean"].answer
        for text in (str(known), str(known.rows())):
            assert FOUND in re.sub(r"\s+", " ", text)
        assert findings(known)[0].verdict == known.contrasts["mean"].answer


@pytest.mark.parametrize(("unrelated_gain", "says"), [(4.0, False), (10.0, True), (12.0, True)])
def test_a_reason_says_that_an_unrelated_task_did_as_well(unrelated_gain, says):
    arms = dict(controlled(10.0, 4.0, placebo=4.0).arms)
    arms["mean"] = replace(arms["mean"], knows_target=True)
    arms["mean, unrelated"] = flat(unrelated_gain + np.roll(NOISE, 2), "mean")
    comparison = of_arms(arms)
    assert (NO_MORE in comparison.contrasts["mean"].answer) is says
    assert comparison.know_nothing["mean"] == ("mean, placebo", "mean, constant mean")
    by_hand = of_arms({**arms, "mean": replace(arms["mean"], knows_target=False)})
    assert by_hand.contrasts["mean"].answer == "pays, by what it knows"
    lost = of_arms({**arms, "mean": flat(NOISE - 5, knows_target=True)})
    assert NO_MORE not in lost.contrasts["mean"].answer


def test_it_stands_in_a_forecast():
    foreseen = cr.forecast(auto(), seeds=1, trial=False)
    for text in (foreseen.answer, foreseen.text(), repr(foreseen)):
        assert FOUND in re.sub(r"\s+", " ", text)
    assert re.sub(r"\s+", " ", foreseen.text()).count(FOUND) == 1
    with_trial = cr.forecast(auto(), seeds=1, trial=True)
    assert with_trial.answer.endswith(f", {FOUND}")
    assert FOUND not in cr.forecast(corner(), seeds=1, trial=False).text()


@pytest.mark.usefixtures("quick_disk")
def test_it_is_kept_in_the_folder_of_a_study(tmp_path):
    (tmp_path / "own.toml").write_text(STUDY.replace("seeds = 2", "seeds = 6"))
    again(tmp_path)
    study = StudyResults(tmp_path / "out")
    assert study.record.arms["transfer"].knows_target
    assert not study.record.arms["scratch"].knows_target
    assert study.comparison.contrasts["transfer"].answer.endswith(FOUND)
    assert read_study(tmp_path / "own.toml").curriculum("transfer").knows_target("maze")
    assert FOUND in study.record.arms["transfer"].transfers[0].words


PAID = 646  # of two random MDPs that have nothing to do with each other, the source "paid"
ALIKE = 634  # of two road maps, the values of one serve the other


@pytest.fixture
def by_values(monkeypatch):
    """Searches find the pair of the nearest value, too."""
    for module in ("transfer.search", "comparison.controls"):
        search = partial(find_mappings, searches=SEARCHED)
        monkeypatch.setattr(f"curricle.{module}.find_mappings", search)


def test_a_mapping_is_refused_where_the_dynamics_disagree(by_values):
    """Values that are alike are found in any source; what leads where is not."""
    _, target, source = unrelated(ALIKE)
    best = find_mappings(target, source, searches=SEARCHED)[0]
    assert best.scores.dynamics_error > MOST_APART
    assert best.scores.regained_where_known > 0.25
    assert best.scores.unexplained < 0.75
    says = r"a dynamics error of at most 0\.4: .* has an error of 0\.9\d+; to accept it, pass"
    with pytest.raises(MappingError, match=says):
        auto_mapping(target, source)
    with pytest.raises(CurriculumError, match="no mapping for source -> target: a mapping is used"):
        auto(target, source)
    assert auto(target, source, best.mapping).knows_target("target")


def test_an_unrelated_source_never_pays_by_what_it_knows(by_values):
    """It was said of both; the benchmark plays 50 that no constant was fitted on."""
    for number in (343, PAID):
        _, target, source = unrelated(number)
        mapping = find_mappings(target, source, searches=SEARCHED)[0].mapping
        budget = {"source": cr.StoppingRule(500), "target": 20_000}
        plan = auto(target, source, mapping, budget=budget)
        asked = {"opponents": ["constant"], "controls": ["placebo", "unrelated"]}
        compared = compare(plan, seeds=10, **asked)
        answer = compared.contrasts["transfer"].answer
        assert answer.endswith(FOUND)
        assert "pays, by what it knows" not in answer
        assert compared.unrelated_verdicts["transfer"].direction <= 0
        assert compared["transfer, unrelated"].curve.source_steps.tolist() == [500] * 10


def test_the_unrelated_source_has_the_size_and_the_prizes_of_the_source_and_no_more():
    plan = corner()
    seeds = list(range(DRAWS))
    mdp = tables(plan.tasks["corner"])
    seen = []
    for draw in seeds:
        sources, edges = unrelated_transfers(plan, seeds, draw)
        for edge in edges:
            task = edge.mapping.source
            assert edge.mapping.knows_target
            np.testing.assert_array_equal(
                np.sort(task.outcome_row.ravel()), np.sort(mdp.outcome_row.ravel())
            )
            assert task.reward is mdp.reward or (task.reward == mdp.reward).all()
            assert sources[edge.source].values.shape == (DRAWS, *mdp.outcome_row.shape)
        seen.append(task.outcome_row)
        assert score_mapping(edge.mapping).coverage > 0
        again = unrelated_transfers(plan, seeds, draw)[1][0].mapping
        assert (again.index == edges[0].mapping.index).all()
    assert not any((one == mdp.outcome_row).all() for one in seen)
    assert not (seen[0] == seen[1]).all()


def test_seeds_take_unrelated_tasks_in_turn():
    """A seed's result does not depend on the seeds beside it."""
    several = compare(copied(MAZE), seeds=[1, 2, 4], controls=["unrelated"])["transfer, unrelated"]
    alone = compare(copied(MAZE), seeds=[4], controls=["unrelated"])["transfer, unrelated"]
    np.testing.assert_array_equal(several.curve.values[2], alone.curve.values[0])
