"""The ledger of a design: every environment step under a class with a price, and computations.

Steps are whole numbers, and computations are kept in whole nanoseconds, so that sums do not depend
on the order in which they are made.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from difflib import get_close_matches
from math import fsum
from types import MappingProxyType
from typing import Any, Self

from curricle.checks import number, whole_number
from curricle.design.break_even import BreakEven, Saving, break_even
from curricle.errors import SettingError

CLASSES = ("target", "sources", "miniatures", "mapping_search", "calibration", "evaluation")
"""What environment steps are booked under; `evaluation` is of rollouts, in any task."""
COMPUTATIONS = ("sweeps", "exact_evaluations")
"""What processor time is booked under: sweeps over tables, and exact values of policies."""
NANOSECONDS = 1_000_000_000
"""In a second."""
KEYS = ("steps", "prices", "seconds")
"""Of a ledger in a file."""


@dataclass(frozen=True, repr=False)
class Ledger:
    """What a design spent: environment steps by class, their prices, and processor time.

    A frozen value. Prints as a table.

    Parameters
    ----------
    steps : dict of str to int
        Environment steps of the :data:`CLASSES`; of a class that is left out, none.
    prices : dict of str to float
        Of one step of a class; 1 where it is left out, and 0 only where that is said.
    nanoseconds : dict of str to int
        Processor time of the :data:`COMPUTATIONS`. It has no price: the cost is that of steps.

    Raises
    ------
    SettingError
        On an unknown class, or a number that is negative or not finite.

    Examples
    --------
    >>> spent = Ledger(prices={"miniatures": 0.01}).book(target=20_000, miniatures=1_500_000)
    >>> spent.cost
    35000.0
    >>> print(spent.book_seconds(sweeps=0.25))
                      steps  price a step    cost
    target           20,000             1  20,000
    miniatures    1,500,000          0.01  15,000
    total         1,520,000                35,000
    sweeps           0.25 s
    >>> Ledger().book(sweets=5)
    Traceback (most recent call last):
    curricle.errors.SettingError: a class of steps must be one of target, sources, miniatures, ...
    """

    steps: Any = ()
    prices: Any = ()
    nanoseconds: Any = ()

    def __post_init__(self) -> None:
        steps = _given("steps", self.steps, CLASSES, "a class of steps")
        prices = _given("prices", self.prices, CLASSES, "a class of steps")
        times = _given("nanoseconds", self.nanoseconds, COMPUTATIONS, "a class of computations")
        steps = {k: _whole(f"steps of {k}", v) for k, v in steps.items()}
        prices = {k: number(f"the price of {k}", v, SettingError, 0) for k, v in prices.items()}
        times = {k: _whole(f"nanoseconds of {k}", v) for k, v in times.items()}
        for name, found, classes, default in (
            ("steps", steps, CLASSES, 0),
            ("prices", prices, CLASSES, 1.0),
            ("nanoseconds", times, COMPUTATIONS, 0),
        ):
            whole = {one: found.get(one, default) for one in classes}
            object.__setattr__(self, name, MappingProxyType(whole))

    # -- booking -------------------------------------------------------------------------------

    def book(self, **steps: int) -> Self:
        """Return the ledger with these steps added to their classes.

        Examples
        --------
        >>> Ledger().book(sources=500).book(sources=100, target=1000).steps["sources"]
        600
        """
        added = _given("steps", steps, CLASSES, "a class of steps")
        more = {k: _whole(f"steps of {k}", v) for k, v in added.items()}
        return replace(self, steps={k: n + more.get(k, 0) for k, n in self.steps.items()})

    def book_seconds(self, **seconds: float) -> Self:
        """Return the ledger with seconds of processor time added, to the nanosecond.

        Examples
        --------
        >>> Ledger().book_seconds(sweeps=0.1).book_seconds(sweeps=0.2).seconds["sweeps"]
        0.3
        """
        added = _given("seconds", seconds, COMPUTATIONS, "a class of computations")
        more = {k: _nanoseconds(k, v) for k, v in added.items()}
        times = {k: n + more.get(k, 0) for k, n in self.nanoseconds.items()}
        return replace(self, nanoseconds=times)

    def with_prices(self, **prices: float) -> Self:
        """Return the ledger with other prices of these classes.

        Examples
        --------
        >>> Ledger().book(target=1000, sources=50).with_prices(sources=0).cost
        1000.0
        """
        return replace(self, prices={**self.prices, **prices})

    def __add__(self, other: object) -> Self:
        """Return both ledgers as one; SettingError if a class has two prices."""
        if not isinstance(other, Ledger):
            return NotImplemented
        for name in CLASSES:
            if self.prices[name] != other.prices[name]:
                raise SettingError(
                    f"ledgers are added at one price of each class: that of {name} is "
                    f"{self.prices[name]:g} and {other.prices[name]:g}"
                )
        times = {k: n + other.nanoseconds[k] for k, n in self.nanoseconds.items()}
        return replace(self.book(**other.steps), nanoseconds=times)

    # -- sums ----------------------------------------------------------------------------------

    @property
    def seconds(self) -> dict[str, float]:
        """Processor time of each class of computations, in seconds."""
        return {name: one / NANOSECONDS for name, one in self.nanoseconds.items()}

    @property
    def costs(self) -> dict[str, float]:
        """Steps times price of each class."""
        return {name: self.prices[name] * steps for name, steps in self.steps.items()}

    @property
    def cost(self) -> float:
        """The sum of steps times price, in steps whose price is 1."""
        return fsum(self.costs.values())

    @property
    def total_steps(self) -> int:
        """The environment steps of all classes."""
        return sum(self.steps.values())

    def break_even(self, saving: Saving) -> BreakEven:
        """Return after how many trainings of the target what is booked here has paid.

        Book the search alone: a training's own steps, with those of its sources, are part of what
        it saves.

        Parameters
        ----------
        saving : float or Interval
            What each training with the design costs less than one without, in steps whose price is
            1, its sources charged.

        Raises
        ------
        SettingError
            When the saving is not finite.

        Examples
        --------
        >>> print(Ledger().book(miniatures=90_000).break_even(11_000))
        the search has paid after 9 trainings
        >>> print(Ledger().book(miniatures=90_000).break_even(-500))
        the search never pays: a training with the design costs 500 more than one without
        """
        return break_even(self.cost, saving)

    # -- files and printing --------------------------------------------------------------------

    def to_dict(self) -> dict[str, dict[str, Any]]:
        """Return the ledger as plain dicts, for TOML and JSON; classes without steps are left out.

        Examples
        --------
        >>> Ledger().book(target=100).to_dict()
        {'steps': {'target': 100}, 'prices': {'target': 1.0}, 'seconds': {}}
        """
        priced = {k for k in CLASSES if self.steps[k] or self.prices[k] != 1}
        return {
            "steps": {k: n for k, n in self.steps.items() if n},
            "prices": {k: price for k, price in self.prices.items() if k in priced},
            "seconds": {k: seconds for k, seconds in self.seconds.items() if seconds},
        }

    @classmethod
    def from_dict(cls, given: Mapping[str, Mapping[str, Any]]) -> Self:
        """Return the ledger of plain dicts, as :meth:`to_dict` makes them.

        Every class that has steps must have its price there: a file is read where nobody can ask.

        Raises
        ------
        SettingError
            Where a price is missing, or as in the class.

        Examples
        --------
        >>> Ledger.from_dict({"steps": {"target": 100}})
        Traceback (most recent call last):
        curricle.errors.SettingError: the price of target is missing: 100 steps of it are booked
        """
        if not isinstance(given, Mapping) or not set(given) <= set(KEYS):
            shown = list(given) if isinstance(given, Mapping) else given
            raise SettingError(f"a ledger has the tables {', '.join(KEYS)}: got {shown!r}")
        found = cls(given.get("steps", {}), given.get("prices", {}))
        for name, steps in found.steps.items():
            if steps and name not in given.get("prices", {}):
                raise SettingError(
                    f"the price of {name} is missing: {steps:,} steps of it are booked"
                )
        seconds = _given(
            "seconds", given.get("seconds", {}), COMPUTATIONS, "a class of computations"
        )
        return found.book_seconds(**seconds)

    def __str__(self) -> str:
        rows = [("", "steps", "price a step", "cost")]
        for name, steps in self.steps.items():
            if steps:
                price, cost = self.prices[name], self.costs[name]
                rows.append((_words(name), f"{steps:,}", f"{price:g}", amount(cost)))
        rows.append(("total", f"{self.total_steps:,}", "", amount(self.cost)))
        times = {_words(name): f"{one:,.3g} s" for name, one in self.seconds.items() if one}
        rows += [(name, one, "", "") for name, one in times.items()]
        first, *others = (max(map(len, column)) for column in zip(*rows, strict=True))
        lines = (
            row[0].ljust(first)
            + "".join(f"  {cell:>{width}}" for cell, width in zip(row[1:], others, strict=True))
            for row in rows
        )
        return "\n".join(map(str.rstrip, lines))

    def __repr__(self) -> str:
        return f"Ledger({self.total_steps:,} steps at a cost of {amount(self.cost)})"

    def __hash__(self) -> int:
        parts = (self.steps, self.prices, self.nanoseconds)
        return hash(tuple(tuple(part.items()) for part in parts))

    def __reduce__(self) -> Any:
        """Pickle plain dicts: views of dicts cannot be."""
        return Ledger, (dict(self.steps), dict(self.prices), dict(self.nanoseconds))


def amount(cost: float) -> str:
    """Return a cost with thousands separators; of small ones three digits."""
    return f"{cost:,.0f}" if cost >= 100 or cost == int(cost) else f"{cost:.3g}"


def _given(name: str, given: Any, classes: tuple[str, ...], what: str) -> dict[str, Any]:
    """Return a dict whose keys are classes; SettingError names what is unknown."""
    try:
        found = dict(given)
    except (TypeError, ValueError):
        raise SettingError(f"{name} of a ledger must be a dict by class: got {given!r}") from None
    for one in found:
        if one not in classes:
            close = get_close_matches(str(one), classes, n=1)
            meant = f", did you mean {close[0]!r}?" if close else ""
            raise SettingError(f"{what} must be one of {', '.join(classes)}: got {one!r}{meant}")
    return found


def _whole(name: str, value: Any) -> int:
    """Return a whole number, at least 0, of any size: sums of ledgers grow beyond 64 bits."""
    if isinstance(value, int) and not isinstance(value, bool) and value >= 0:
        return value
    return whole_number(name, value, 0, SettingError)


def _nanoseconds(name: str, seconds: Any) -> int:
    return round(number(f"seconds of {name}", seconds, SettingError, 0) * NANOSECONDS)


def _words(name: str) -> str:
    return name.replace("_", " ")
