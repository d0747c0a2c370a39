"""Public results have a short repr, some print lines; columns of text tables stay apart."""

import inspect
import io
import re
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from hypothesis import given, strategies as st
from PIL import Image

import curricle as cr
from curricle.text import GAP, text_table

EVIL = "<b>&\"'"
LONGEST = 1_000  # characters of a repr
HUNT, CHASE = cr.Pursuit(size=3, predators=2, time_limit=50), cr.Pursuit(3, 1, time_limit=50)


def plan():
    return cr.Curriculum(
        tasks={EVIL: CHASE, "hunt": HUNT},
        transfers=[
            cr.Transfer(EVIL, "hunt", cr.project(HUNT, CHASE, predator=name))
            for name in HUNT.predator_names
        ],
        aggregate=cr.minimum,
        budget=3_000,
    )


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """Results of all kinds, by name."""
    maze = cr.GridWorld(["S..", ".PT"])
    by_name = {"curriculum": plan()}
    by_name["training"] = trained = plan().train(seeds=2, snapshots=2)
    by_name["learning"] = learnt = trained["hunt"]
    by_name["without evaluation"] = cr.learn(
        maze, budget=500, evaluation=cr.GreedyEvaluation(method="off")
    )
    by_name["decisions"] = trained.decisions(EVIL)
    by_name["no decisions"] = trained.decisions("hunt")
    by_name["snapshots"], by_name["source"] = learnt.snapshots, trained.sources[EVIL]
    by_name["potential"] = trained.potentials["hunt"][0]
    by_name["transfer"] = plan().transfers[0]
    by_name["mapping"] = plan().transfers[0].mapping
    by_name["index mapping"] = cr.same_position(maze, maze.crop(rows=(0, 2), columns=(1, 3)))
    by_name["coverage"] = by_name["mapping"].coverage()
    by_name["comparison"] = compared = cr.compare({EVIL: plan()}, seeds=4, controls=["placebo"])
    by_name["arm"], by_name["curve"] = compared[EVIL], compared[EVIL].curve
    by_name["contrast"], by_name["verdict"] = compared.contrasts[EVIL], compared.verdicts[EVIL]
    by_name["reason"], by_name["times"] = compared.reasons[EVIL], compared.times(EVIL)
    by_name["forecast"] = forecast = cr.forecast(plan(), seeds=2, trial=True)
    by_name["row"], by_name["trial"] = forecast.rows[0], forecast.trial
    by_name["source learning"] = forecast.sources[EVIL]
    by_name["solution"] = cr.solve(HUNT)
    by_name["values"] = cr.evaluate(maze, np.zeros(maze.states.size, int))
    by_name["episode"] = cr.planning.rollout(maze, np.zeros(maze.states.size, int))
    by_name["certificate"] = cr.certify(maze, cr.StateShaping(np.zeros(maze.states.size)))
    unsafe = cr.certificate.ShapingReward(lambda s, a, after: 500.0 * (after == s))
    by_name["refutation"] = cr.certify(maze, unsafe)
    by_name["mappings"] = cr.transfer.find_mappings(CHASE, CHASE)
    by_name["found mapping"] = by_name["mappings"][0]
    by_name["candidates"] = cr.candidates.source_candidates(maze)
    tasks = {
        name: {"type": "maze", "map": line, "budget": 500}
        for name, line in (("near", ".ST"), ("far", "S.T"))
    }
    edges = [{"source": "near", "target": "far", "mapping": "same_position"}]
    arm = {"tasks": tasks, "transfers": edges}
    data = {"name": "line", "seeds": [0, 1], "arms": {EVIL: arm}}
    by_name["study"] = cr.study.StudyConfig.from_data(data, Path())
    folder = tmp_path_factory.mktemp("study") / "out"
    by_name["study results"] = cr.run_study(by_name["study"], folder, progress=False)
    by_name["stored result"] = by_name["study results"].result(EVIL, "far")
    by_name["policy"] = cr.learn(cr.GridWorld("S" + 2_000 * "." + "T"), budget=500).policy
    by_name["store"] = by_name["study results"].store
    return by_name


PRINTED = ("comparison", "forecast", "certificate", "refutation", "candidates", "mappings")
"""Results whose lines a notebook shows, not their `repr`."""


def test_a_repr_is_short_and_says_what_it_is(results):
    for result in results.values():
        text = repr(result)
        assert text.startswith(type(result).__name__)
        assert len(text) < LONGEST
        assert not re.search("0x|\n", text)
    assert str(results["study"]) == repr(results["study"])


def test_a_repr_gives_no_return_that_was_not_evaluated():
    result = cr.learn(CHASE, cr.QLearning(), 1, evaluation=cr.GreedyEvaluation(method="off"))
    assert repr(result) == "LearningResult(QLearning, 1 seed, 1 step and 0 episodes a seed)"


def test_every_class_of_a_package_of_results_has_a_repr_of_its_own():
    packages = (cr.comparison, cr.curriculum, cr.certificate, cr.learning, cr.planning)
    kinds = {getattr(package, name) for package in packages for name in package.__all__}
    bare = [k.__name__ for k in kinds if inspect.isclass(k) and k.__repr__ is object.__repr__]
    assert set(bare) <= {"Shaping", "ShapingReward", "Learner"}


def test_results_that_print_several_lines_show_them_in_a_notebook(results):
    for name in PRINTED:
        html, text = results[name]._repr_html_(), str(results[name])
        assert ElementTree.fromstring(html).text == text, name
        assert ("&lt;b&gt;" in html) == (EVIL in text), name


def test_a_figure_is_one_picture_in_a_notebook(results):
    figure = cr.plot(results["comparison"])
    png, size = figure._repr_png_()
    picture = Image.open(io.BytesIO(png))
    assert picture.size == (2 * size["width"], 2 * size["height"])
    assert not hasattr(figure, "_repr_html_") or figure._repr_html_() is None


HEADS = ("", "steps to threshold", "strong gain", "verdict")
NAMES = st.text("abc -[]>漢", min_size=1, max_size=60).map(str.strip).filter(bool)
ROWS = st.lists(
    st.tuples(
        NAMES,
        st.integers(0, 10**12).map("{:,}".format),
        st.floats(-1e6, 1e6).map("{:.4g} [0.1, 0.2]".format),
        st.sampled_from(["", "pays (p = 0.002)", "too few seeds for a verdict (2; 6 or more)"]),
    ),
    min_size=1,
    max_size=5,
)


@given(rows=ROWS, width=st.integers(40, 200), prose=st.booleans())
def test_lines_fit_and_nothing_is_lost(rows, width, prose):
    lines = text_table(HEADS, rows, width, prose=prose)
    assert max(map(len, lines)) <= width
    there = re.sub(r"\s", "", "".join(lines))
    for row in rows:
        assert row[1] in "".join(lines)  # a number is never cut
    assert len(there) >= sum(len(re.sub(r"\s", "", cell)) for row in rows for cell in row)


def test_a_name_folds_between_its_words_alone():
    name = "share, constant maximum (initial_value=8.743)"
    for width in range(25, 80):  # the numbers take 13
        lines = text_table(["", "return"], [(name, "93.5 [89, 97]")], width)
        assert any("(initial_value=8.743)" in line for line in lines), width


@given(rows=ROWS)
def test_columns_never_touch(rows):
    lines = text_table(HEADS[:3], [row[:3] for row in rows])
    ends = []
    for line, row in zip(lines[1:], rows, strict=True):
        assert line.endswith(row[2])
        before = line[: -len(row[2])].rstrip()
        assert len(line) - len(row[2]) - len(before) >= GAP
        assert before.endswith(row[1])
        ends.append((len(line), len(before)))
    assert len(set(ends)) == 1  # numbers are aligned to the right
