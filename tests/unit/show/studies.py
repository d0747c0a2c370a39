"""Small studies for the tests of the report, and a strict reader of its page."""

from html.parser import HTMLParser
from types import SimpleNamespace

import curricle as cr
from curricle.comparison.plan import PlannedArm
from curricle.show import report as module
from curricle.study.analysis import analysed, curricula_record
from curricle.tasks.grid import cell_space
from tests.support.tasks import predator_edges

VOID = {"meta", "link", "input", "br", "hr", "img", "col", "source", "wbr"}
ODD = "a <b>&\"' $\\frac{a$ </script>"
"""A name with special characters of HTML, of scripts and of Matplotlib's mathematics."""


def shown(results):
    """The record of results by arm, what their tasks learnt, and the analysis of it."""
    arms = {arm: PlannedArm(result.curriculum, {}) for arm, result in results.items()}
    record = curricula_record(arms)
    return record, {arm: result.nodes for arm, result in results.items()}, analysed(results, record)


def study_page(name, comparison, results, *, decisions=None, environment=None):
    """The page of arms by name; ``decisions`` are why trainings ended, for some of them."""
    curricula, learnt, analysis = shown(results)

    def reasons(arm, task):
        default = learnt[arm][task].ended_by.tolist()
        return dict(enumerate((decisions or {}).get((arm, task), default)))

    run = {"file": "", "started": "", "commit": "", "python": "", "machine": ""}
    study = {"comparison": comparison, "analysis": analysis, "results": learnt, "failed": {}}
    study["record"] = SimpleNamespace(
        name=name, only=lambda _: curricula, tuned=None, arms=curricula.arms, variants={}
    )
    study["store"] = SimpleNamespace(has=lambda _: False)
    study |= {"ended_by": reasons, "seeds": range(comparison.seeds)}
    study["runs"] = [SimpleNamespace(**run, versions=environment or {})]
    return module.page_of(SimpleNamespace(**study))


def page_of(study):
    """The page of what :func:`record` made."""
    return study_page(**vars(study))


def record(name, plans, seeds, moments=5, **settings):
    """A study as the store holds it: comparison and training results with snapshots."""
    comparison = cr.compare(plans, seeds=seeds, **settings)
    first = next(iter(plans.values()))
    target = first.target
    scratch = cr.Curriculum({target: first.tasks[target]}, budget=comparison.total)
    arms = {"scratch": scratch, **plans}
    results = {arm: plan.train(seeds, snapshots=moments) for arm, plan in arms.items()}
    environment = {"curricle": "0.1.0", "command": "curricle run study.toml <now>"}
    made = {"name": name, "comparison": comparison, "results": results}
    return SimpleNamespace(**made, decisions={}, environment=environment)


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


def of_cells(shape, after, *labels):
    """Return a task of rows and columns: every move leads from each cell to that in `after`."""
    return cr.FiniteMDP.from_outcomes(
        [[[(1.0, state, -1.0)]] * len(labels) for state in after],
        **{"start": 0, "terminal": [False] * len(after), "discount": 0.9},
        states=cell_space(*shape),
        actions=cr.Space([cr.Component("move", len(labels), labels=labels)]),
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
        if len(dict(attrs)) != len(attrs):
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
