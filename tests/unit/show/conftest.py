"""Studies that the tests of the report read."""

import pytest

import curricle as cr

from .studies import ODD, chain_plan, hunt_plan, maze_plan, page_of, record


@pytest.fixture(scope="package")
def pursuit():
    plans = {"min": hunt_plan(cr.minimum), "mean": hunt_plan(cr.mean)}
    return record("Two predators", plans, 8, controls=["placebo"])


@pytest.fixture(scope="package")
def maze():
    return record("A maze", {"2x2": maze_plan(2), "3x3": maze_plan(3)}, 3)


@pytest.fixture(scope="package")
def odd():
    study = record(ODD, {f"{ODD} arm": chain_plan()}, 2)
    study.decisions = {(f"{ODD} arm", f"{ODD} short"): (f"{ODD} reason", "all steps used")}
    study.environment = {f"{ODD} key": f"{ODD} value"}
    return study


@pytest.fixture(scope="package")
def pages(pursuit, maze, odd):
    return {"pursuit": page_of(pursuit), "maze": page_of(maze), "odd": page_of(odd)}


@pytest.fixture(params=["pursuit", "maze", "odd"])
def page(request, pages):
    return pages[request.param]


@pytest.fixture(scope="package")
def plan():
    return hunt_plan(cr.mean)


@pytest.fixture(scope="package")
def hunt(plan):
    return plan.tasks["hunt"]


@pytest.fixture(scope="package")
def trained(plan):
    return plan.train(2)
