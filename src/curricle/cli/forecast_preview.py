"""The forecasts that ``curricle check`` prints.

They are those of ``curricle.forecast``: from sources trained at their budgets for the study's first
seeds, which takes seconds and is said beforehand; and, in a line or where training would take too
long, from sources that are solved, as if they were learnt perfectly.
"""

from collections.abc import Mapping, Sequence
from textwrap import fill
from typing import Any

from curricle.comparison.forecasting import Forecast, forecast
from curricle.curriculum.curriculum import Curriculum
from curricle.curriculum.sources import SourceValues
from curricle.errors import CurricleError
from curricle.study.arms import Arms
from curricle.study.config.study_config import StudyConfig
from curricle.study.cost import Cost, duration

LONGEST = 30.0
"""Seconds of training on one processor, by the estimate, up to which a look beforehand is quick."""
SEEDS = 3
"""Seeds of the sources, as many as ``curricle.forecast`` takes by default; one if that is slow."""


def print_forecasts(study: StudyConfig, arms: Arms, each: Sequence[Cost]) -> None:
    """Print a forecast for each arm with transfers into the target; `each` is what it costs."""
    curricula = {name: one for name, one in arms.curricula.items() if one.in_edges(one.target)}
    sources = {
        arms.keys[name, source]: source
        for name, one in curricula.items()
        for source in one.ancestors(one.target)
    }
    if not sources:
        return
    by_key = {arms.keys[one.arm, one.task]: one.seconds / one.seeds for one in each}
    a_seed = sum(by_key[key] for key in sources)
    names = ", ".join(dict.fromkeys(sources.values()))
    counts = [n for n in (min(SEEDS, len(study.seeds)), 1) if n * a_seed <= LONGEST]
    if not counts:
        print(
            f"\ntraining {names} for one seed would take about {duration(a_seed)}, so these "
            "forecasts are for sources learnt perfectly; curricle.forecast trains them"
        )
        for name, curriculum in curricula.items():
            print(f"\narm {name}", _forecast(curriculum, perfect=True), sep="\n")
        return
    seeds = study.seeds[: counts[0]]
    plural = "s" * (len(seeds) > 1)
    print(
        f"\ntraining {names} for {len(seeds)} seed{plural}, for the forecast: about "
        f"{duration(len(seeds) * a_seed)}",
        flush=True,
    )
    _print_trained(curricula, arms, seeds)


def _print_trained(curricula: Mapping[str, Curriculum], arms: Arms, seeds: Sequence[int]) -> None:
    """Print the forecast of each arm from trained sources; those that arms share are trained once.

    A line for sources that are learnt perfectly follows, where they can be solved.
    """
    known: dict[str, SourceValues] = {}
    for name, curriculum in curricula.items():
        own = {source: arms.keys[name, source] for source in curriculum.ancestors(arms.target)}
        trained = {source: known[key] for source, key in own.items() if key in known}
        found = _forecast(curriculum, seeds=seeds, trained=trained)
        print(f"\narm {name}", found, sep="\n")
        if isinstance(found, Forecast):
            known |= {own[source]: values for source, values in found.trained.items()}
            perfect = _forecast(curriculum, perfect=True)
            if isinstance(perfect, Forecast):
                print(fill(_in_a_line(perfect), 80, subsequent_indent="  "))


def _in_a_line(found: Forecast) -> str:
    """Return the forecast of the potential that is used, in a line."""
    used = next(row for row in found.rows if row.used)
    return f"{found.computed_from}: {used.name} {used.verdict}"


def _forecast(curriculum: Curriculum, **settings: Any) -> Forecast | str:
    """Return a forecast, or why there is none."""
    try:
        return forecast(curriculum, **settings)
    except (CurricleError, ImportError) as error:
        return f"no forecast: {error}"
