"""Schedules: learning rates, exploration and weights that change while learning."""

from typing import NamedTuple

from curricle.arrays import IntArray
from curricle.checks import number
from curricle.errors import SettingError
from curricle.tasks.kernel import overloaded

# Shapes of a schedule.
CONSTANT, LINEAR, EXPONENTIAL, HARMONIC = range(4)


class Schedule(NamedTuple):
    """A number as a function of the steps taken; build it with the functions of this module.

    A harmonic learning rate counts the updates of its state-action pair instead of all steps.

    Attributes
    ----------
    shape : int
        Constant, linear, exponential or harmonic.
    first, last : float
        The value at step 0, and the one that it tends to.
    span : float
        The scale of time, in steps (updates).

    Examples
    --------
    >>> decay = linear(1.0, 0.1, steps=900)
    >>> decay(0), decay(10_000)
    (1.0, 0.1)
    """

    shape: int
    first: float
    last: float
    span: float

    def __call__(self, step: int) -> float:
        """Return the value after `step` steps (updates)."""
        return float(_schedule_at(self, step))

    @property
    def kernel(self) -> "Constant | Schedule":
        """The schedule for compiled loops: a constant has a type of its own."""
        return Constant(self.first) if self.shape == CONSTANT else self


def constant(value: float) -> Schedule:
    """Return the schedule whose value is always `value`."""
    always = number("a schedule", value, SettingError)
    return Schedule(CONSTANT, always, always, 1.0)


def linear(first: float, last: float, *, steps: int) -> Schedule:
    """Return the schedule that is linear from `first` to `last` over `steps`, then constant.

    Examples
    --------
    >>> linear(1.0, 0.0, steps=100)(25)
    0.75
    """
    return _checked(LINEAR, first, last, "steps", steps)


def exponential(first: float, last: float = 0.0, *, half_life: float) -> Schedule:
    """Return the schedule ``last + (first - last) * 0.5 ** (n / half_life)``, n the steps taken.

    Examples
    --------
    >>> exponential(1.0, half_life=10)(20)
    0.25
    """
    return _checked(EXPONENTIAL, first, last, "half_life", half_life)


def harmonic(first: float = 1.0, last: float = 0.0, *, half: float = 1.0) -> Schedule:
    """Return the schedule ``last + (first - last) / (1 + n / half)``, n the steps taken.

    As a learning rate n counts the updates of the pair, so that ``harmonic()`` is 1 / (n + 1), the
    sample mean, and the Robbins-Monro conditions hold.

    Examples
    --------
    >>> harmonic()(3)
    0.25
    """
    return _checked(HARMONIC, first, last, "half", half)


def _checked(shape: int, first: float, last: float, name: str, span: float) -> Schedule:
    """Return a schedule, or raise SettingError unless its numbers are finite and `span` > 0."""
    if not number(name, span, SettingError) > 0:
        raise SettingError(f"{name} must be positive: got {span}")
    ends = number("first", first, SettingError), number("last", last, SettingError)
    return Schedule(shape, *ends, float(span))


def schedule(value: "float | Schedule") -> Schedule:
    """Return a number as a constant schedule, a schedule as it is."""
    return value if isinstance(value, Schedule) else constant(value)


def within(name: str, value: "float | Schedule", low: float, high: float) -> Schedule:
    """Return `value` as a schedule that starts and ends in [low, high], or raise SettingError."""
    if not isinstance(value, Schedule):
        return constant(number(name, value, SettingError, low, high))
    for end in (value.first, value.last):
        number(name, end, SettingError, low, high)
    return value


# -- in compiled code ----------------------------------------------------------------------------


class Constant(NamedTuple):
    """A schedule that never changes."""

    value: float


class ByVisits(NamedTuple):
    """A learning rate that depends on the updates of each pair."""

    schedule: Schedule
    visits: IntArray  # (rows, A)


# Types of their own: a check of the shape at each step would take 5 % of the fast loop's time, and
# 80 % of that of one with two learners.


@overloaded()
def at(schedule, step):
    """Return the value of a schedule after `step` steps."""


@overloaded()
def rate_of(learning_rate, row, action, step):
    """Return the learning rate of an update, and count the visit if it depends on visits."""


@at.body(Constant)
def _constant_at(schedule, step):
    return schedule.value


@at.body(Schedule)
def _schedule_at(schedule, step):
    if schedule.shape == CONSTANT:
        return schedule.first
    if schedule.shape == LINEAR:
        done = step / schedule.span
        done = done if done < 1.0 else 1.0
        return schedule.first + (schedule.last - schedule.first) * done
    if schedule.shape == EXPONENTIAL:
        return schedule.last + (schedule.first - schedule.last) * 0.5 ** (step / schedule.span)
    return schedule.last + (schedule.first - schedule.last) / (1.0 + step / schedule.span)


@rate_of.body(Constant)
def _constant_rate(learning_rate, row, action, step):
    return learning_rate.value


@rate_of.body(Schedule)
def _rate_by_steps(learning_rate, row, action, step):
    return at(learning_rate, step)


@rate_of.body(ByVisits)
def _rate_by_visits(learning_rate, row, action, step):
    count = learning_rate.visits[row, action]
    learning_rate.visits[row, action] += 1
    return at(learning_rate.schedule, count)
