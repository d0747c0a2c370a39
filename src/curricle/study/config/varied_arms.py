"""The arms of a study whose settings vary, by a sweep or a tuning, in plain data."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from curricle.checks import unfit_name
from curricle.study.config.merging import Raw
from curricle.study.config.sweeps import HOME, Variant, scratch_variants, variants_of
from curricle.study.config.tables import KeyPath
from curricle.study.config.tuning_tables import TuneTable, places_of_tuning, tuned_in
from curricle.study.config.varied_settings import value_text, with_values

Homes = dict[str, tuple[str, Mapping[KeyPath, KeyPath]]]
"""As :attr:`Positions.varied`."""


class VariedArms(NamedTuple):
    """What a sweep and a tuning make of a study."""

    fields: dict[str, Any]
    """Of the configuration."""
    probes: dict[str, Raw]
    """Arms with the ends of each range that is tuned, to be checked beforehand."""
    homes: Homes


def varied_arms(study: Raw, complete: Mapping[str, Raw]) -> VariedArms:
    """Return the arms of a study that sweeps or tunes settings.

    Parameters
    ----------
    study : dict
        As read, nothing wrong with its sweep and its tuning.
    complete : dict of str to dict
        The curricula of its arms without them.
    """
    variants, scratches = variants_of(study, complete), scratch_variants(study, complete)
    each, first = {**scratches, **variants}, next(iter(complete))
    fields: dict[str, Any] = {
        "arms": {name: one.curriculum for name, one in variants.items()},
        "scratches": {name: one.curriculum for name, one in scratches.items()},
        "variants": {name: {"arm": one.arm, "values": one.values} for name, one in each.items()},
    }
    homes: Homes = {
        name: (first if name in scratches else one.arm, one.homes) for name, one in each.items()
    }
    probes = dict[str, Raw]()
    if "tune" in study:
        tune = TuneTable.model_validate(study["tune"])
        places = places_of_tuning(study, variants, scratches)
        space = {one.name: one.given for one in tuned_in(study)}
        fields["tune"] = {**tune.model_dump(), "space": space, "places": places}
        for name, curriculum, where in _probes(study, each, places):
            probes[name], homes[name] = curriculum, (first, where)
    return VariedArms(fields, probes, homes)


def _probes(
    study: Raw,
    variants: Mapping[str, Variant],
    places: Mapping[str, Mapping[str, tuple[KeyPath, ...]]],
) -> Iterator[tuple[str, Raw, dict[KeyPath, KeyPath]]]:
    """Yield an arm for each end of each tuned setting, and where the file has that."""
    for one in tuned_in(study):
        arm = next(arm for arm in places if places[arm][one.name])
        here = places[arm][one.name]
        for value in _some(one.given):
            given = with_values(variants[arm].curriculum, dict.fromkeys(here, value))
            yield f"{one.name} = {value_text(value)}", given, dict.fromkeys(here, one.home)


def _some(space: Any) -> Sequence[Any]:
    """Return the values of a setting that are checked: those listed, or ends and one between.

    That one is no whole number unless all are, which some settings refuse.
    """
    if not isinstance(space, dict):
        return tuple(space)
    low, high = space["low"], space["high"]
    whole = isinstance(low, int) and isinstance(high, int)
    return (low, high) if whole else (low, high, low + (high - low) / 3**0.5)


def wrong_made(variants: Mapping[str, Any]) -> Iterator[tuple[KeyPath, str]]:
    """Yield what is wrong with the names of the arms that a sweep makes."""
    for name in variants:
        if why := unfit_name(name):
            yield HOME, f"makes an arm with a name that {why}"
