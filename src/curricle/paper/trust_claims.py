"""The claims of the trust figure: answers to the paper's questions, each with a control."""

from typing import Any

import numpy as np

from curricle import QInitialisation, RewardBonus, StateShaping, certify
from curricle.learning import LearningResult
from curricle.paper import hacking
from curricle.paper.maze_runs import WINDOW
from curricle.paper.settings import Claim, answer, over_seeds
from curricle.paper.trust_runs import EXAMINED, SWEEP, TrustRuns, tenths
from curricle.statistics import Curve, Interval, paired_difference, time_to_threshold

WHERE = "5x5, both must catch, epsilon-greedy 0.1, discount 0.95, truncated at 100, 400,000 steps"
MOSTLY = 0.5
"""Share of seeds in which the choice in a cell must have become wrong."""
NEAR = 1.05
"""Cost of a calibrated arm at most, relative to the best scale set by hand."""


def claims(found: TrustRuns) -> tuple[Claim, ...]:
    """Return the claims of the trust figure."""
    return (
        _certified(found),
        _ranking(found),
        _collapse_predicted(found),
        _calibrated(found),
        _larger(found),
        _placebo(found),
        _not_just_longer(found),
        _refused(found),
        _guarded(found),
        _left_out(found),
    )


def _end(result: LearningResult) -> Any:
    return tenths(result)[:, -1]


def _change(result: LearningResult) -> Interval:
    parts = tenths(result)
    return paired_difference(parts[:, -1], parts[:, 0])


def _certified(found: TrustRuns) -> Claim:
    fitted = found.forecast["mean"].calibrations[0].potential
    safe = certify(fitted.task, QInitialisation(fitted))
    hint = certify(hacking.MAZE, RewardBonus(hacking.nearness()))
    control = certify(hacking.MAZE, StateShaping(hacking.nearness()))
    return Claim(
        "trust.certified",
        "Whether a shaping keeps the optimal policy can be proven: the calibrated potential does, "
        "and so does the hint as a potential; as a bonus it does not, and the state is named",
        "5x5 pursuit, mean calibrated; the 5x5 grid of the reward hacking",
        answer(bool(safe) and bool(control) and hint.holds is False),
        {
            "calibrated mean": str(safe),
            "hint as a bonus": str(hint),
            "as a potential": str(control),
        },
    )


def _ranking(found: TrustRuns) -> Claim:
    rows = {name: found.forecast[name].mean("start") for name in found.forecast.ranking}
    curves = {name: found.compared[name].curve for name in ("min", "mean", "max")}
    first = {name: over_seeds(curve.values[:, 0]) for name, curve in curves.items()}
    order = [float(one.estimate) for one in first.values()]
    seen = rows["minimum"] > rows["mean"] > rows["maximum"]
    return Claim(
        "trust.forecast-ranks",
        "Open question: why does max win? A forecast before training shows that it does not: as "
        "stated, the exact starts of the greedy policies have the order min, mean, max",
        f"{WHERE}; forecast from the sources alone, control: the first checkpoint of the runs",
        answer(seen and order == sorted(order, reverse=True)),
        {f"{name}, predicted": value for name, value in rows.items()}
        | {f"{name}, measured": value for name, value in first.items()},
    )


def _collapse_predicted(found: TrustRuns) -> Claim:
    words = {name: found.forecast[name].verdict for name in ("minimum", "mean")}
    measured = {name: _change(found.hunts[5, name]) for name in ("min", "mean")}
    right = "expect a fall" in words["mean"] and "no fall" in words["minimum"]
    return Claim(
        "trust.collapse-foretold",
        "Open question: why does performance collapse? Overestimation; measured before training, "
        "it predicts which aggregate collapses and which does not",
        f"{WHERE}; training return, last minus first tenth",
        answer(right and measured["mean"].high < 0 < measured["min"].low),
        {f"{name}, predicted": value for name, value in words.items()}
        | {f"{name}, measured": value for name, value in measured.items()},
    )


def _calibrated(found: TrustRuns) -> Claim:
    numbers: dict[str, Any] = {}
    near = rising = True
    for name in ("min", "mean"):
        ends = {c: float(_end(found.hunts[5, f"{name} x {c:g}"]).mean()) for c in SWEEP}
        ends[1.0] = float(_end(found.hunts[5, name]).mean())
        best = max(ends, key=ends.__getitem__)
        fitted = found.hunts[5, f"{name}, calibrated"]
        numbers[f"{name}, calibrated, last tenth"] = over_seeds(_end(fitted))
        numbers[f"{name}, best scale by hand"] = best
        numbers[f"{name}, last tenth at that scale"] = ends[best]
        numbers[f"{name}, calibrated, last minus first tenth"] = _change(fitted)
        near &= float(_end(fitted).mean()) > NEAR * ends[best]
        rising &= bool(_change(fitted).low > 0)
    return Claim(
        "trust.calibration",
        "Open question: would scaling the source Q values cure the collapse? A scale fitted to "
        "the returns of phi's greedy policy in 200 episodes, which count as target steps, does: "
        "returns rise, and end within 5 % of those of the best scale set by hand",
        f"{WHERE}; control: scales {', '.join(f'{c:g}' for c in (1.0, *SWEEP))}",
        answer(near and rising),
        numbers,
    )


def _larger(found: TrustRuns) -> Claim:
    arms = ("min", "min, calibrated", "mean", "mean, calibrated")
    ends = {name: over_seeds(_end(found.hunts[7, name])) for name in arms}
    halved = all(
        ends[f"{name}, calibrated"].estimate > ends[name].estimate / 2 for name in ("min", "mean")
    )
    return Claim(
        "trust.calibration-7x7",
        "On 7x7, where every uncalibrated aggregate collapses, calibration more than halves the "
        "final cost",
        "7x7, both must catch, epsilon-greedy 0.1, discount 0.95, limit 200, 1,000,000 steps",
        answer(halved),
        {f"{name}, last tenth": value for name, value in ends.items()},
    )


def _placebo(found: TrustRuns) -> Claim:
    gains = {name: one.strong_gain for name, one in found.controls.contrasts.items()}
    main = gains["mean, calibrated"]
    others = [gains[f"mean, calibrated, {name}"] for name in ("placebo", "negated")]
    return Claim(
        "trust.placebo",
        "What the source has learnt helps, not the size of its values: shuffled (placebo) or "
        "negated they do not help",
        f"{WHERE}; mean return above scratch, source steps counted",
        answer(main.low > 0 and all(one.high < main.low / 2 for one in others)),
        gains,
    )


def _not_just_longer(found: TrustRuns) -> Claim:
    contrasts = found.controls.contrasts
    gains = {
        name: contrasts[f"mean, calibrated, {name}"].strong_gain
        for name in ("random start", "pretraining")
    }
    main = contrasts["mean, calibrated"].strong_gain
    return Claim(
        "trust.not-just-longer",
        "The gain is not due to more steps or to other starts: as many steps in the target itself, "
        "from its own start or from anywhere, do not give it",
        f"{WHERE}; mean return above scratch, source steps counted",
        answer(all(one.high < main.low / 2 for one in gains.values())),
        gains | {"transfer": main},
    )


def _refused(found: TrustRuns) -> Claim:
    shares = found.refused
    return Claim(
        "trust.scale-is-the-wrong-model",
        "Where rewards have both signs a scale is the wrong model, and calibration refuses to "
        "fit one",
        "10x10 maze, step reward -5, sources of 3x3 to 10x10 cells",
        answer(float(np.mean(list(shares.values()))) > 0.95),
        {f"size {size}, share of seeds refused": share for size, share in shares.items()},
    )


def _guarded(found: TrustRuns) -> Claim:
    threshold = found.scratch.threshold
    steps = {
        name: time_to_threshold(Curve.of(result), threshold, window=WINDOW).steps
        for name, result in found.maze.items()
    }
    saved = {
        name: over_seeds(steps["scratch"] - steps[name])
        for name in ("from the 3x3 corner", "the same, guarded")
    }
    guarded = saved["the same, guarded"]
    return Claim(
        "trust.guard",
        "A harmful source (size 3) does no harm, within noise, to a learner with a guard",
        "10x10 maze, step reward -5; target steps to the threshold saved",
        answer(guarded.high >= 0 and saved["from the 3x3 corner"].high < -10_000),
        {f"{name}, steps saved": value for name, value in saved.items()}
        | {"scratch, steps to threshold": over_seeds(steps["scratch"])},
    )


def _left_out(found: TrustRuns) -> Claim:
    exits = {(2, 8), (2, 9)}
    added = {
        f"row {row}, column {column}": float(share)
        for (row, column), share in zip(found.scratch.maze.cells, found.added_wrong, strict=True)
        if (row, column) in exits
    }
    return Claim(
        "trust.whose-doing",
        "The harm of size 3 lies where the optimal path leaves the corner and comes back: there "
        "the source makes the greedy choice wrong",
        f"10x10 maze, step reward -5, after {EXAMINED:,} steps; source left out, all else the same",
        answer(max(added.values()) >= MOSTLY),
        {f"wrong choices added in {cell}, share of seeds": x for cell, x in added.items()},
    )
