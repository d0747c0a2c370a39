"""Small studies for the tests of the report, and a strict reader of its page."""

from dataclasses import replace
from html.parser import HTMLParser
from types import SimpleNamespace

import numpy as np

import curricle as cr
from curricle.learning.record import Snapshots
from curricle.study.analysis import analysed, curricula_record
from tests.study_pages import study_page
from tests.tasks import predator_edges

VOID = {"meta", "link", "input", "br", "hr", "img", "col", "source", "wbr"}
ODD = "a <b>&\"' $\\frac{a$ </script>"
"""A name with special characters of HTML, of scripts and of Matplotlib's mathematics."""


def kept_snapshots(result, name, moments=5):
    """Five moments of seed 0, each a training of its own: a shorter one is a prefix of a longer."""
    node, curriculum = result[name], result.curriculum
    phi = (result.potentials.get(name) or [None])[0]
    end = int(node.steps_used[0])
    steps = np.linspace(0, end, moments).astype(np.int64)
    space = node.task.states.size, node.task.actions.size
    first = np.zeros(space) if phi is None else phi.values
    values = [first] + [
        cr.learn(
            node.task,
            curriculum.setting("learner", name),
            int(n),
            seeds=[0],
            shaping=cr.QInitialisation(phi),
            eval_freq=int(n),
            stream=name,
        ).values[0]
        for n in steps[1:]
    ]
    return Snapshots(0, steps, np.array(values, dtype=np.float32))


def with_snapshots(result, **kept):
    """A result with the snapshots of some tasks."""
    shown = {name: replace(result[name], snapshots=one) for name, one in kept.items()}
    return replace(result, nodes={**result.nodes, **shown})


def shown(results):
    """The record of results by arm, what their tasks learnt, and the analysis of it."""
    record = curricula_record({arm: one.curriculum for arm, one in results.items()}, {})
    return record, {arm: one.nodes for arm, one in results.items()}, analysed(results, record)


def page_of(study):
    return study_page(
        study.name,
        study.comparison,
        study.results,
        decisions=study.decisions,
        environment=study.environment,
    )


def record(name, plans, seeds, moments=5, **settings):
    """A study as the store holds it: comparison and training results with snapshots."""
    comparison = cr.compare(plans, seeds=seeds, **settings)
    first = next(iter(plans.values()))
    target = first.target
    scratch = cr.Curriculum({target: first.tasks[target]}, budget=comparison.total)
    results = {"scratch": scratch.train(seeds)}
    results |= {arm: plan.train(seeds) for arm, plan in plans.items()}
    for arm, result in results.items():
        kept = {node: kept_snapshots(result, node, moments) for node in result.nodes}
        results[arm] = with_snapshots(result, **kept)
    return SimpleNamespace(
        name=name,
        comparison=comparison,
        results=results,
        decisions={},
        environment={"curricle": "0.1.0", "command": "curricle run study.toml <now>"},
    )


def hunt_plan(aggregate, **transfer):
    hunt, chase = (cr.Pursuit(3, n, discount=0.9, time_limit=30) for n in (2, 1))
    return cr.Curriculum(
        {"chase": chase, "hunt": hunt},
        predator_edges(hunt, chase, **transfer),
        aggregate=aggregate,
        budget={"chase": 4000, "hunt": 8000},
        shaping=cr.QInitialisation(),
    )


def maze_plan(size):
    maze = cr.GridWorld(["...T", ".PP.", "F...", "S.#."], time_limit=40)
    corner = maze.crop(rows=(0, size), columns=(4 - size, 4))
    return cr.Curriculum(
        {"corner": corner, "maze": maze},
        [cr.Transfer("corner", "maze", cr.same_position(maze, corner))],
        budget={"corner": 500, "maze": 3000},
        shaping=cr.QInitialisation(),
    )


def chain(n):
    outcomes = [[[(1.0, max(s - 1, 0), -1.0)], [(1.0, s + 1, -1.0)]] for s in range(n - 1)]
    ended = [False] * (n - 1) + [True]
    return cr.FiniteMDP.from_outcomes(
        [*outcomes, [[], []]], terminal=ended, start=0, discount=0.9, time_limit=30
    )


def chain_plan(name=ODD):
    long, short = chain(8), chain(5)
    f = cr.from_function(long, short, lambda s, a: ({"state": s["state"] - 3}, a))
    return cr.Curriculum(
        {f"{name} short": short, f"{name} long": long},
        [cr.Transfer(f"{name} short", f"{name} long", f, scale=1.5)],
        budget={f"{name} short": 300, f"{name} long": 1500},
    )


class Reader(HTMLParser):
    """Reads a page strictly: every element that opens closes, in order."""

    def __init__(self, page):
        super().__init__()
        self.open, self.elements, self.text, self.problems = [], [], [], []
        self.feed(page)
        self.close()

    def handle_starttag(self, tag, attrs):
        names = [name for name, _ in attrs]
        if len(set(names)) != len(names):
            self.problems.append(f"{tag} repeats an attribute")
        self.elements.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        if tag not in VOID and "svg" not in self.open:
            self.problems.append(f"{tag} closes itself outside SVG")
        self.elements.append((tag, dict(attrs)))

    def handle_endtag(self, tag):
        if not self.open or self.open.pop() != tag:
            self.problems.append(f"{tag} closes what is not open")

    def handle_data(self, data):
        if self.open and self.open[-1] not in ("script", "style"):
            self.text.append(data)

    def values(self, attribute, tag=None):
        return [a[attribute] for t, a in self.elements if attribute in a and tag in (None, t)]

    @property
    def words(self):
        return " ".join(" ".join(self.text).split())


def labelled(axes):
    """The lines with a name of their own."""
    return {line.get_label(): line for line in axes.lines if line.get_label()[0] != "_"}


def texts_of(axes):
    return [text.get_text() for text in axes.texts]
