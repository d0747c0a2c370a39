"""Is the portfolio as good as the better of its learners? Bars: no loss above .1, 85 % of the gain.

    python -m benchmarks.portfolio --split verification --seeds 20   # or unseen, development, blind
    python -m benchmarks.portfolio --split verification --live       # and without a model?
    python -m benchmarks.portfolio --split blind --charged           # does the default pay?

`--live` hides the tables of targets and sources behind environments: the portfolio's bounds are by
phi's range, sources are learnt by `QLearning`, policies are evaluated by rollouts. Only the
optimistic learner is told the bounds of the rewards.

`--charged` compares each sensible pair's curriculum, nothing set but the target's budget, with all
opponents: its verdict, the gain over the best opponent, what that opponent leaves to the optimum
(all three as shares of the way), and the steps of the source as a share of the target's.

    for study in benchmarks/large/*.toml; do
        curricle run $study --out large/$(basename $study .toml)
    done
    python -m benchmarks.portfolio --results large/*

prints for each arm of finished studies the mean greedy return over the target's own steps, and over
all steps, sources charged, as shares of the way.

Played are the sensible sources of the pairs, by their default budgets, each also negated, and two
deceptive cases: lines whose near prize the source knows, and an inventory's negated potential (a
pair of the stocks). Scores are mean returns while learning, as shares of the way from the random
policy (0) to the optimum (1): of the training episodes (t), and of the greedy policy (g). Gains
are over learning from scratch; a loss is against the best of scratch, the raw source and the
optimistic learner. Training returns are undiscounted, and say nothing where the discounted optimum
is no better than random play by them. The source's steps are not charged, as all that the portfolio
decides on comes after them; `cost` is their share of the target's.
"""

import argparse
import warnings
from bisect import bisect
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from random import Random
from typing import Any

import numpy as np

import curricle as cr
from benchmarks.pairs import Pair, pairs
from benchmarks.pairs.pair import Family, levels
from benchmarks.pairs.worlds import task_of
from benchmarks.portfolio_pairs import UNSEEN
from curricle.learning import OptimisticQLearning, value_bounds
from curricle.planning.target import Target
from curricle.statistics.curves import Curve, mean_return
from curricle.study import StudyResults
from curricle.transfer import StateActionMapping

PARTS, MOST_LOSS, LEAST_KEPT = 20, 0.1, 0.85
RIVALS = ("scratch", "source", "optimist")
SEEN = ("deep-sea", "frozen-lake")
"""Verification families of all else, on which the rule's constants were fitted too."""
EXPLORING_RUINS = ("gambler",)
"""Families where random play earns nine tenths of the optimum, and exploring loses the stake."""
MOVE = cr.Component("move", 2, labels=("left", "right"))


def line(n: int, far: float = 1.0) -> cr.FiniteMDP:
    """Return a line with a prize of .3 near the start and another at its far end."""

    def outcomes(point: Any, action: int) -> Any:
        to = point[0] + (1 if action else -1)
        return [(1.0, (to,), 0.3 if to == 0 else far if to == n - 1 else 0.0)]

    return task_of(
        [(i,) for i in range(n)], ("place",), MOVE, outcomes,
        ends=lambda point: point[0] in (0, n - 1), starts=lambda point: point[0] == 2,
        discount=0.95, time_limit=100,
    )  # fmt: skip


def lines(split: str) -> Family:
    """Return lines whose source knows the near prize alone."""
    family = Family("deceptive", "verification" if split == "verification" else "development")
    for n in (8, 10, 12) if split == "verification" else (9, 11, 13):
        family.target(f"line {n}", line(n), 15_000)
        family.add("near", f"near prize, {n}", line(n, far=0.0), budget=1000)
    return family


def bets(goal: int, chance: float) -> cr.FiniteMDP:
    """Return the gambler's problem: stakes of 1, 2, 4, ... until all or nothing."""
    stakes = [2**k for k in range(goal.bit_length() - 1)]

    def outcomes(point: Any, action: int) -> Any:
        stake = min(stakes[action], point[0], goal - point[0])
        won = point[0] + stake
        return [
            (chance, (won,), 1.0 if won == goal else 0.0),
            (1 - chance, (point[0] - stake,), 0.0),
        ]

    return task_of(
        [(i,) for i in range(goal + 1)], ("place",), cr.Component("stake", len(stakes)), outcomes,
        ends=lambda point: point[0] in (0, goal), starts=lambda point: point[0] == goal // 2,
        discount=1.0, time_limit=500,
    )  # fmt: skip


def gamblers() -> Family:
    """Return the gambler's problem with 32 coins, from a kinder one and a fair one."""
    family = Family("gambler", "verification")
    family.target("32 coins", bets(32, 0.4), 40_000)
    for kind, chance in (("near", 0.45), ("far", 0.5)):
        family.add(kind, f"chance {chance}", bets(32, chance), budget=4_000)
    return family


def pursuits() -> Family:
    """Return the hunt of two predators, whose pairs are twice as many as the steps."""
    family = Family("pursuit", "development")
    hunt, chase = cr.Pursuit(size=4, predators=2), cr.Pursuit(size=4, predators=1)
    family.target("4x4", hunt, 50_000)
    maps = [cr.project(hunt, chase, predator=name) for name in hunt.predator_names]
    family.add("near", "two alone", chase, *maps, budget=5_000)
    return family


def chosen(split: Any) -> Iterator[Pair]:
    """Yield the sensible pairs of a split, each also negated."""
    if split == "unseen":
        played = [pair for family in UNSEEN for pair in family().pairs.values()]
    elif split in ("blind", "fresh"):
        played = pairs(split)
    else:
        seen = [pair for family in SEEN for pair in pairs(family=family)]
        apart = [pair for pair in pairs(split) if pair.family not in SEEN]
        more = gamblers() if split == "verification" else pursuits()
        played = [*apart, *more.pairs.values(), *lines(split).pairs.values()]
        played += seen if split == "development" else ()
    for pair in (pair for pair in played if pair.sensible):
        yield pair
        yield replace(pair, name=f"{pair.name}, negated", kind="negated", scale=-pair.scale)


class Hidden:
    """An environment that tells the number of each state of a task, and no tables."""

    def __init__(self, mdp: cr.FiniteMDP) -> None:
        self.start, self.pairs = np.cumsum(mdp.start).tolist(), mdp.outcome_row.tolist()
        self.chances = np.cumsum(mdp.probability, axis=1).tolist()
        self.after, self.reward = mdp.next_state.tolist(), mdp.reward.tolist()
        self.ends = mdp.terminal.tolist()

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[int, dict[str, Any]]:
        if seed is not None:
            self.random = Random(seed).random
        self.state = bisect(self.start, self.random() * self.start[-1])
        return self.state, {}

    def step(self, action: int) -> tuple[int, float, bool, bool, dict[str, Any]]:
        row = self.pairs[self.state][action]
        outcome = bisect(self.chances[row], self.random() * self.chances[row][-1])
        self.state = self.after[row][outcome]
        return self.state, self.reward[row][outcome], self.ends[self.state], False, {}

    def close(self) -> None:
        pass


def hidden(pair: Pair) -> Pair:
    """Return a pair whose tasks are played live."""
    target, source = (
        cr.tasks.LiveMDP(
            task.states, task.actions, partial(Hidden, task.mdp), discount=task.mdp.discount,
            time_limit=task.mdp.time_limit,
        )
        for task in (pair.target, pair.source)
    )  # fmt: skip
    maps = tuple(StateActionMapping(target, source, read.index) for read in pair.mappings)
    return replace(pair, source=source, target=target, mappings=maps)


def played(pair: Pair, seeds: int, live: bool = False) -> dict[str, Any]:
    """Return the scores of all arms of a pair."""
    random, optimum = levels(pair.target)
    training = Target.of(pair.target, cr.GreedyEvaluation(method="exact", discounted=False))
    optimist = OptimisticQLearning(value_range=value_bounds(pair.target))
    pair = hidden(pair) if live else pair
    evaluation = cr.GreedyEvaluation(method="rollouts" if live else "exact")
    task, steps = pair.target, pair.target_budget
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        freq = {"target": pair.eval_freq}
        curriculum = pair.curriculum(
            shaping=None, budget={"target": steps}, eval_freq=freq, evaluation=evaluation
        )
        source = curriculum.train(seeds, only="source", workers=1)["source"]
        potentials = curriculum.potentials("target", {"source": source})
    way = training.optimum - training.random_return
    portfolio = [cr.QInitialisation(phi, portfolio=cr.Portfolio()) for phi in potentials]
    arms: dict[str, Any] = {
        "scratch": {},
        "source": {"shaping": [cr.QInitialisation(phi) for phi in potentials]},
        "optimist": {"learner": optimist},
        "portfolio": {"shaping": portfolio},
    }
    row: dict[str, Any] = {"pair": pair.name, "family": pair.family}
    row["cost"] = float(np.mean(source.steps_used)) / steps
    for arm, settings in arms.items():
        result = cr.learn(
            task, budget=steps, seeds=seeds, eval_freq=steps // PARTS, workers=1,
            evaluation=evaluation, **settings,
        )  # fmt: skip
        curve = result.training_return.copy()
        curve[:, 0] = training.random_return
        for k in range(1, curve.shape[1]):  # a part in which no episode ends keeps the last mean
            curve[:, k] = np.where(np.isnan(curve[:, k]), curve[:, k - 1], curve[:, k])
        gain = float(curve[:, 1:].mean() - training.random_return)
        height = mean_return(Curve(result.steps, result.greedy_return)).mean()
        row[arm] = {"t": gain / way if way > 0 else np.nan}
        row[arm]["g"] = (height - random) / (optimum - random)
        if arm == "portfolio":
            row["share"] = float(result.source_share[:, 1:].mean())
    return row


def charged(pair: Pair, seeds: int) -> dict[str, Any]:
    """Return the verdict on a pair's curriculum by default, and its figures."""
    curriculum = pair.curriculum(
        shaping=None, budget={"target": pair.target_budget}, eval_freq={"target": pair.eval_freq}
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = cr.compare(curriculum, seeds=seeds, workers=1)
    (arm,) = found.contrasts
    random, optimum = levels(pair.target)
    gain = found.contrasts[arm].strong_gain
    parts = [part / (optimum - random) for part in (gain.estimate, gain.low, gain.high)]
    cost = float(np.mean(found.arms[arm].curve.source_steps)) / pair.target_budget
    return {
        "pair": pair.name, "answer": found.contrasts[arm].answer, "gain": parts,
        "headroom": found.headroom(arm), "cost": cost,
    }  # fmt: skip


def judge_charged(rows: list[dict[str, Any]]) -> None:
    """Print how many pairs pay, by what the best opponent leaves."""
    gains, room, costs = (
        np.array([np.ravel(row[key])[0] for row in rows]) for key in ("gain", "headroom", "cost")
    )
    pays = np.array([row["answer"].startswith("pays") for row in rows])
    for name, some in (("all", room > -1), (f"above {MOST_LOSS}", room > MOST_LOSS)):
        print(
            f"{name}: {pays[some].sum()} of {some.sum()} pay, mean gain {gains[some].mean():+.3f}; "
            f"the source takes {np.median(costs[some]):.1%} of the target's steps (median)"
        )


def print_shares(folder: str) -> None:
    """Print the mean greedy return of each arm of a study as shares of the way."""
    results = StudyResults(folder)
    comparison, name = results.comparison, results.record.name
    random, optimum = comparison.reference.random_return, comparison.reference.optimum
    assert random is not None, "the target has tables"
    assert optimum is not None, "the target has tables"
    print(f"{name:46}{'source':>8}{'uncharged':>11}{'charged':>9}")
    for arm in comparison.shown:
        curve = comparison[arm].curve
        own = curve.steps <= comparison.budget
        uncharged = mean_return(Curve(curve.steps[own], curve.values[:, own])).mean()
        shares = [(r - random) / (optimum - random) for r in (uncharged, comparison.returns[arm])]
        means = [float(np.mean(share)) for share in shares]
        print(f"{arm:46}{curve.source_steps.mean():8,.0f}{means[0]:11.2f}{means[1]:9.2f}")


def main() -> None:
    """Play all pairs, print a row for each and the bars."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--split", default="development")
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--charged", action="store_true")
    parser.add_argument("--results", nargs="+", help="folders of studies to print shares of")
    parser.add_argument("--live", action="store_true")
    settings = parser.parse_args()
    for folder in settings.results or ():
        print_shares(folder)
    if settings.results:
        return
    rows = []
    if settings.charged:
        sensible = [pair for pair in chosen(settings.split) if pair.kind != "negated"]
        with ProcessPoolExecutor(settings.workers) as pool:
            for row in pool.map(partial(charged, seeds=settings.seeds), sensible):
                rows.append(row)
                gain, low, high = row["gain"]
                print(
                    f"{row['pair'][:45]:46}{row['cost']:6.1%}  leaves {row['headroom']:4.2f}  "
                    f"{gain:+.3f} [{low:+.3f}, {high:+.3f}]  {row['answer']}", flush=True,
                )  # fmt: skip
        judge_charged(rows)
        return
    print(f"{'':46}cost share  " + "  ".join(f"{arm:>10}" for arm in (*RIVALS, "portfolio")))
    with ProcessPoolExecutor(settings.workers) as pool:
        play = partial(played, seeds=settings.seeds, live=settings.live)
        for row in pool.map(play, chosen(settings.split)):
            rows.append(row)
            cells = (f"{row[arm]['t']:5.2f}{row[arm]['g']:5.2f}" for arm in (*RIVALS, "portfolio"))
            head = f"{row['pair'][:45]:46}{row['cost']:4.2f} {row['share']:5.2f}  "
            print(head + "  ".join(cells), flush=True)
    for name in ("t", "g"):
        judge(name, [row for row in rows if row["family"] not in EXPLORING_RUINS])


def judge(name: str, rows: list[dict[str, Any]]) -> None:
    """Print the bars on training returns or on greedy ones."""
    rows = [row for row in rows if not np.isnan(row["portfolio"][name])]
    scores = np.array([[row[arm][name] for arm in (*RIVALS, "portfolio")] for row in rows])
    loss = scores[:, :3].max(axis=1) - scores[:, 3]
    kept = (scores[:, 3] - scores[:, 0]).mean() / (scores[:, 1:3].max(axis=1) - scores[:, 0]).mean()
    lost = [f"{rows[k]['pair']} {loss[k]:.2f}" for k in np.argsort(-loss) if loss[k] > MOST_LOSS]
    deceptive = [k for k, row in enumerate(rows) if row["family"] == "deceptive"]
    behind = (scores[deceptive, 2] - scores[deceptive, 3]).max(initial=-np.inf)
    met = "MET" if not lost and kept >= LEAST_KEPT else "MISSED"
    print(
        f"{name}: {met}; largest loss {loss.max():.2f}, above {MOST_LOSS} in {len(lost)} of "
        f"{len(rows)} ({'; '.join(lost)}); keeps {kept:.0%} of the better one's gain; at most "
        f"{behind:.2f} behind the optimistic learner on deceptive lines"
    )


if __name__ == "__main__":
    main()
