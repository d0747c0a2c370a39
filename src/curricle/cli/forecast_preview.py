"""The forecasts that ``curricle check`` prints.

They are those of ``curricle.forecast``: a trial in the model, and potentials from sources trained
at their budgets for the study's first seeds, which takes seconds and is said beforehand; and, in a
line or where training would take too long, from sources that are solved, as if learnt perfectly.
"""

import sys
from collections.abc import Mapping, Sequence
from typing import Any

from curricle.cli.terminal_tables import line_width, print_text
from curricle.comparison.candidates import AGGREGATES, candidates_of
from curricle.comparison.forecasting import JudgedPotentials, forecast_once
from curricle.comparison.forecasts import Forecast
from curricle.comparison.trial import affordable, hindrance
from curricle.curriculum.curriculum import Curriculum
from curricle.curriculum.sources import SourceValues
from curricle.errors import CurricleError, SettingError
from curricle.planning.target import LARGEST_EVALUATED, LARGEST_SOLVED, ROLLOUTS
from curricle.study.arms import Arms
from curricle.study.config.study_config import StudyConfig
from curricle.study.cost import Cost, duration, sweeping_seconds
from curricle.tasks.observation_task import is_observation_task
from curricle.tasks.task import generative_model, has_tables
from curricle.text_tables import counted
from curricle.transfer.observation_rollouts import OBSERVATION_ROLLOUTS

LONGEST = 5.0
"""Estimated seconds, on one processor, up to which sources are trained for a forecast."""
LONGEST_DISTILLED = 60.0
"""The same where networks are distilled: there is no forecast without them."""
LONGEST_COMPARING = 300.0
"""Seconds that comparing potentials in the target may take: nearly all episodes end long before the
limit by which they are estimated."""
PAIR_SECONDS = 2e-6
"""Of comparing a potential with the optimal value of a pair: about 0.8 s for 390,625 pairs."""
ACTION_SECONDS = 4e-9
"""Of reading phi for one action at a step of a rollout: 3e-9 to 4e-9 for two sources."""
LONGEST_TRIAL = 60.0
"""Seconds that the trials may take by the machine's own pace."""
SEEDS = 3
"""Seeds of the sources, as many as ``curricle.forecast`` takes by default; one if that is slow."""


def print_forecasts(study: StudyConfig, arms: Arms, each: Sequence[Cost]) -> None:
    """Print a forecast for each arm with transfers into the target; `each` is what it costs."""
    # Not those of `arms`, whose target has the total: a trial adds the sources' steps by itself.
    shown = _first_settings(study)
    curricula = {
        name: one
        for name, one in study.curricula.items()
        if name in shown and one.in_edges(one.target)
    }
    if len(shown) < len(study.arms):
        print("\nforecasts are for the first settings of each arm")
    sources = {
        arms.keys[name, source]: source
        for name, one in curricula.items()
        for source in one.ancestors(one.target)
    }
    if not sources:
        return
    target = next(one for one in each if one.task == arms.target)
    comparing = sum(_comparing_seconds(one, target.step_seconds) for one in curricula.values())
    comparing *= min(SEEDS, len(study.seeds))
    if comparing > LONGEST_COMPARING:
        print()
        print_text(
            f"no forecast: to compare the potentials in {arms.target} could take "
            f"{duration(comparing)}; curricle.forecast does it, also with fewer episodes"
        )
        return
    by_key = {arms.keys[one.arm, one.task]: one.seconds / one.seeds for one in each}
    a_seed = sum(by_key[key] for key in sources)
    names = ", ".join(dict.fromkeys(sources.values()))
    distilled = any(_distils(one) for one in curricula.values())
    longest = LONGEST_DISTILLED if distilled else LONGEST
    counts = [n for n in (min(SEEDS, len(study.seeds)), 1) if n * a_seed <= longest]
    if not counts:
        print()
        print_text(
            f"training {names} for one seed would take about {duration(a_seed)}, so these "
            "forecasts are for sources learnt perfectly; curricle.forecast trains them"
        )
        judged = JudgedPotentials()
        for name, curriculum in curricula.items():
            _print(name, _forecast(judged, curriculum, perfect=True))
        return
    seeds = study.seeds[: counts[0]]
    tried, seconds = _trials(curricula, a_seed, target)
    quick = seconds <= LONGEST_TRIAL
    words = f"training {names} for {counted(len(seeds), 'seed')}"
    words += f" and trials of {counted(tried, 'seed')}" * bool(tried and quick)
    took = duration(len(seeds) * a_seed + seconds * quick)
    took += " after tabulating what is distilled" * distilled
    print()
    print_text(f"{words}, for the forecast: about {took}")
    if not quick:
        print_text(f"trials would take about {duration(seconds)} and are left out")
    sys.stdout.flush()
    trial = None if quick else False
    _print_trained(curricula, arms, seeds, trial=trial, threshold=study.threshold)


def _distils(curriculum: Curriculum) -> bool:
    """Return whether a source's exact answers are fitted by a network."""
    sources = curriculum.ancestors(curriculum.target)
    return any(curriculum.node(source).takes_no_steps for source in sources)


def _first_settings(study: StudyConfig) -> set[str]:
    """Return the first arm of each that a sweep makes of an arm in the file."""
    own = {name: (study.variants or {}).get(name) for name in study.arms}
    first = {name if one is None else one.arm: name for name, one in reversed(own.items())}
    return set(first.values())


def _trials(curricula: Mapping[str, Curriculum], a_seed: float, target: Cost) -> tuple[int, float]:
    """Return the most seeds of the trials that forecasts make, and the seconds they take, about.

    `a_seed` are the seconds of all sources, a seed.
    """
    most, seconds = 0, 0.0
    for one in curricula.values():
        if hindrance(one):
            continue
        some, seeds = affordable(candidates_of(one, one.target))
        most = max(most, seeds)
        seconds += seeds * ((1 + len(some)) * target.seconds / target.seeds + len(some) * a_seed)
    return most, seconds


def _comparing_seconds(curriculum: Curriculum, step_seconds: float) -> float:
    """Return the seconds that judging an arm's potentials and sources takes at most, a seed."""
    node, edges = curriculum.node(curriculum.target), curriculum.in_edges(curriculum.target)
    potentials = len(AGGREGATES) + 1 + len(edges) if len(edges) > 1 else 1
    try:
        horizon = node.evaluation.horizon(node.task)
    except SettingError:  # which the forecast will say
        return 0.0
    if node.deep:
        return potentials * OBSERVATION_ROLLOUTS * horizon * step_seconds
    model = generative_model(node.task)
    pairs = model.states.size * model.actions.size
    solving = sum(_solving(curriculum.tasks[edge.source]) for edge in edges)
    rollouts = ROLLOUTS * horizon * (step_seconds + model.actions.size * ACTION_SECONDS)
    if not has_tables(node.task) or pairs > LARGEST_SOLVED:
        return solving + potentials * rollouts
    if pairs * horizon <= LARGEST_EVALUATED:
        rollouts = 0.0
    return solving + potentials * (pairs * PAIR_SECONDS + rollouts)


def _solving(source: Any) -> float:
    """Return the seconds that solving a source twice takes at most: trained, and learnt perfectly.

    In a chain of states each sweep carries values one state further.
    """
    if is_observation_task(source) or not has_tables(source):
        return 0.0
    return 2 * sweeping_seconds(source, generative_model(source).states.size)


def _print_trained(
    curricula: Mapping[str, Curriculum], arms: Arms, seeds: Sequence[int], **settings: Any
) -> None:
    """Print the forecast of each arm from trained sources; those that arms share are trained once.

    A line for sources that are learnt perfectly follows, where they can be solved and are read.
    """
    judged, known = JudgedPotentials(), dict[str, SourceValues]()
    for name, curriculum in curricula.items():
        own = {source: arms.keys[name, source] for source in curriculum.ancestors(arms.target)}
        trained = {source: known[key] for source, key in own.items() if key in known}
        found = _forecast(judged, curriculum, seeds=seeds, trained=trained, **settings)
        _print(name, found)
        if isinstance(found, Forecast):
            known |= {own[source]: values for source, values in found.trained.items()}
            if not curriculum.setting("shaping", arms.target).reads_values:
                continue  # perfect values would change nothing
            perfect = _forecast(judged, curriculum, perfect=True, only_used=True)
            if isinstance(perfect, Forecast):
                print_text(_in_a_line(perfect))


def _print(arm: str, found: Forecast | str) -> None:
    """Print the forecast of an arm, or why there is none."""
    print(f"\narm {arm}")
    if isinstance(found, Forecast):
        print(found.text(line_width()))
    else:
        print_text(found)


def _in_a_line(found: Forecast) -> str:
    """Return the forecast of the potential that is used, in a line."""
    return f"{found.computed_from}: {found.used.name} {found.used.verdict}"


def _forecast(judged: JudgedPotentials, curriculum: Curriculum, **settings: Any) -> Forecast | str:
    """Return a forecast, or why there is none."""
    try:
        return forecast_once(judged, curriculum, **settings)
    except (CurricleError, ImportError) as error:
        return f"no forecast: {error}"
