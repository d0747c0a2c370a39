"""The steps that results state are those that an environment was asked for, in runs of any kind."""

import numpy as np
import pytest

import curricle as cr
from curricle.learning import OptimisticQLearning, RMax

PLACES = 6


class Line:
    """A walk to place 0 that counts the steps of all its copies."""

    taken = 0

    def reset(self, *, seed=None, options=None):
        self.place = PLACES - 1
        return self.place, {}

    def step(self, action):
        type(self).taken += 1
        self.place = min(self.place + 1, PLACES - 1) if action else self.place - 1
        return self.place, -1.0, self.place == 0, False, {}

    def close(self):
        pass


def line():
    """Return the walk as a live task, nothing of it counted yet."""
    Line.taken = 0
    space = cr.Space([cr.Component("place", PLACES)])
    return cr.tasks.LiveMDP(space, cr.Space([cr.Component("move", 2)]), Line, time_limit=20)


def stated(*results):
    """Return the steps that results state; a floor is estimated once for all seeds."""
    return sum(
        int(result.steps_used.sum() + result.evaluation_steps.sum() + result.floor_steps.max())
        for result in results
    )


PHI = np.tile([1.0, 0.0], (PLACES, 1))
SETTLING = cr.StoppingRule(2_000, settled=0.05)
RUNS = {
    "plain": {},
    "without evaluation": {"evaluation": cr.GreedyEvaluation("off")},
    "on-policy": {"learner": cr.SARSA()},
    "two tables": {"learner": cr.DoubleQLearning()},
    "optimistic": {"learner": OptimisticQLearning(value_range=(-20.0, 0.0))},
    "model-based": {"learner": RMax(value_range=(-20.0, 0.0))},
    "sparse": {"storage": cr.Storage("sparse")},
    "from a start": {"shaping": cr.QInitialisation(PHI)},
    "shaped": {"shaping": cr.StateShaping(PHI)},
    "portfolio": {"shaping": cr.QInitialisation(PHI, portfolio=cr.Portfolio())},
    "episodes": {"budget": cr.Episodes(30)},
    "threshold": {"budget": cr.StoppingRule(3_000, threshold=-6.0, patience=2)},
    "settled": {"budget": SETTLING},
    "never settled": {"budget": cr.StoppingRule(300, settled=0.0)},
    "charged": {"charged": [100, 7]},
}


def shown(result, folder):
    """Show a result in every way, and save it."""
    return str(result), repr(result), result.save(folder / "result")


@pytest.mark.parametrize("run", RUNS)
def test_a_run_states_all_steps_of_its_environment(run, tmp_path):
    task = line()
    result = cr.learn(task, **{"budget": 400, "seeds": 2, "eval_freq": 50, **RUNS[run]})
    assert Line.taken == stated(result)
    assert (result.floor_steps.any()) == ("settled" in run)
    assert shown(result, tmp_path)
    assert type(result).load(tmp_path / "result.npz", task).ended_by.tolist() == (
        result.ended_by.tolist()
    )
    assert Line.taken == stated(result)


def test_a_curriculum_states_them_too_and_asks_for_none_to_be_shown(tmp_path):
    task = line()
    edge = cr.Transfer("short", "long", cr.transfer.identity(task))
    budget = {"short": SETTLING, "long": 600}
    plan = cr.Curriculum({"short": task, "long": task}, [edge], budget=budget, eval_freq=50)
    result = plan.train(seeds=2)
    taken = Line.taken
    assert taken == stated(*result.nodes.values())
    assert shown(result, tmp_path)
    for name in plan.tasks:
        ends = [of_seed[-1].criterion for of_seed in result.decisions(name) if of_seed]
        assert ends in ([], result[name].ended_by.tolist())
    assert [*result.unlearnt("long")] == ["short"]
    assert Line.taken == taken


def test_what_ended_a_run_is_recorded_where_it_ended():
    maze = cr.GridWorld("S..T")
    ends = {
        "all steps used": cr.learn(maze, budget=50),
        "all episodes done": cr.learn(maze, budget=cr.Episodes(3)),
        "threshold reached": cr.learn(maze, budget=cr.StoppingRule(9_000, threshold=150.0)),
        "fraction of the optimum reached": cr.learn(
            maze, budget=cr.StoppingRule(9_000, fraction=0.9)
        ),
        "settled return reached": cr.learn(maze, budget=cr.StoppingRule(9_000, settled=0.05)),
        "all steps used, not learnt": cr.learn(
            maze, cr.QLearning(learning_rate=0.0), cr.StoppingRule(900, settled=0.05)
        ),
        "memory full": cr.learn(
            maze, budget=900, storage=cr.Storage("sparse", memory_limit="100 B")
        ),
    }
    assert {result.ended_by[0]: word for word, result in ends.items()} == {w: w for w in ends}
    assert ends["threshold reached"].level[0] == 150.0
    assert np.isnan(ends["all steps used"].level[0])
    assert np.isfinite(ends["settled return reached"].floor[0])
    assert not ends["settled return reached"].floor_steps.any()  # it follows from tables
