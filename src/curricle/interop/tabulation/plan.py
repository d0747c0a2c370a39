"""What a tabulation is asked to do, and doing it."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from curricle.checks import number, whole_number
from curricle.errors import SettingError, TaskError
from curricle.interop.tabulation.assembling import Tables, assembled
from curricle.interop.tabulation.explorables import Listed, ListedOutcomes, StepOutcomes
from curricle.interop.tabulation.exploration import Budget, Explored, Progress, explore
from curricle.interop.tabulation.minigrid import (
    MiniGridAccess,
    MiniGridState,
    fitting_state,
    is_minigrid,
)
from curricle.interop.tabulation.playing import Checker
from curricle.interop.tabulation.state_access import DeepCopy, SaveAndRestore, Words
from curricle.interop.tabulation.table_cache import TableCache, name_of
from curricle.interop.tabulation.tabulated_task import TabulationRecord
from curricle.interop.tabulation.world import World, core_and_views
from curricle.interop.toy_text import has_table, names_of
from curricle.progress import check_progress, shown
from curricle.tasks.spaces import values_of

MOST_SAMPLES = 1_000_000
"""Steps by which the outcomes of a pair are estimated, at most."""


@dataclass(frozen=True)
class Plan:
    """How an environment is tabulated."""

    seeds: tuple[int, ...]
    state: Any
    outcomes: Listed | None
    samples: int | None
    budget: Budget
    progress: bool | Callable[[Progress], Any] | None
    cache: TableCache | None = None

    def check(self) -> None:
        """Raise SettingError if settings are invalid or contradict each other."""
        pair = isinstance(self.state, tuple) and len(self.state) == 2
        known = self.state is None or callable(getattr(self.state, "open", None))
        if not known and not (pair and all(map(callable, self.state))):
            raise SettingError(
                "state must be DeepCopy(...), MiniGridState(...) or two functions, (save, "
                f"restore): got {self.state!r}"
            )
        check_progress(self.progress)
        if self.outcomes is not None and not callable(self.outcomes):
            raise SettingError(f"outcomes must be a function: got {self.outcomes!r}")
        if self.samples is not None:
            samples = whole_number("samples", self.samples, 1, SettingError)
            number("samples", samples, SettingError, high=MOST_SAMPLES)
            if self.outcomes is not None:
                raise SettingError("outcomes are listed or estimated: got outcomes and samples")

    def carried_out(
        self, env: Any, act: Callable[[int], Any], n_actions: int, name: str
    ) -> tuple[Tables, TabulationRecord]:
        """Return an environment's tables, and how they came about; from the cache if there."""
        how = self._how(env)
        if self.cache is None:
            return self._made(env, act, n_actions, name, how)
        ways = [*how] if isinstance(how, tuple) else [how]
        ways += [self.outcomes, self.samples, self.state is None]
        kept = name_of(env, self.seeds, ways)
        found = self.cache.find(kept)
        if found is None:
            self.cache.require_writable()
            found = self._made(env, act, n_actions, name, how)
            self.cache.keep(kept, *found)
        return found

    def _made(
        self, env: Any, act: Callable[[int], Any], n_actions: int, name: str, how: Any
    ) -> tuple[Tables, TabulationRecord]:
        """Return an environment's tables, made anew."""
        if self.state is None and isinstance(how, MiniGridState) and not how.copies:
            fast = MiniGridAccess(own_reward=False)
            try:
                return self._tables(World(env, act, fast, name), n_actions, how)
            except TaskError:
                if not fast.missed(env.unwrapped):
                    raise
                fast.release()
                how = MiniGridState(copies=True)
        pair = isinstance(how, tuple)
        access = SaveAndRestore(*how) if pair else how.open()
        return self._tables(World(env, act, access, name), n_actions, how)

    def _tables(self, world: World, n_actions: int, how: Any) -> tuple[Tables, TabulationRecord]:
        """Return the tables of a world, and how they came about."""
        access = world.access
        source = self._source(world, n_actions)
        found = self._explored(source)
        by_steps = isinstance(source, StepOutcomes)
        sampled = self.samples is not None
        tables = assembled(found, n_actions, sampled=sampled, merge=access.copies and by_steps)
        access.end()
        checked = 0 if sampled else Checker(world, tables, n_actions).check(self.seeds)
        record = TabulationRecord(
            environment=world.name,
            seeds=self.seeds,
            samples=self.samples,
            transitions=source.transitions,
            drawing=world.drawing,
            checked=checked,
            cut=found.cut,
            explored=len(found.terminal),
            seconds=found.seconds,
            observing=found.observing,
            note=getattr(how, "note", ""),
        )
        return tables, record

    def _how(self, env: Any) -> Any:
        """Return how states are saved and restored."""
        if isinstance(self.state, MiniGridState) and not is_minigrid(env):
            raise SettingError(f"state={self.state!r} is for MiniGrid's environments: got {env}")
        if self.state is not None:
            return self.state
        if is_minigrid(env):
            core = core_and_views(env, views_apart=True).core
            return fitting_state(env, core, self.seeds[0])
        return DeepCopy()

    def _source(self, world: World, n_actions: int) -> StepOutcomes | ListedOutcomes:
        """Return what is explored: listed outcomes where there are any, else steps."""
        env, base = world.env, world.env.unwrapped
        if self.outcomes is not None:
            save = self.state[0] if isinstance(self.state, tuple) else None
            return ListedOutcomes(env, self.outcomes, n_actions, self.seeds, world.name, save)
        if self.state is None and self.samples is None and has_table(env):
            table: Any = base
            return ListedOutcomes(
                env,
                lambda s, a: table.P[s][a],
                n_actions,
                self.seeds,
                world.name,
                words=words_of(base),
            )
        return StepOutcomes(world, n_actions, self.seeds, self.samples)

    def _explored(self, source: Any) -> Explored:
        """Return all states, and show the progress if asked to."""
        words = f"tabulating {source.name}"
        with shown(self.progress, lambda: words) as bars:

            def show(now: Progress) -> None:
                nonlocal words
                words = now.in_words(source.name)
                bars.at(source.name, now.expanded, now.states)
                bars.tell(now)

            return explore(source, self.budget._replace(show=show))


def words_of(world: Any) -> Callable[[Any], Words] | None:
    """Return the function from a state of a known environment to its components, if known."""
    states = names_of(world)[0]
    if states is None:
        return None

    def words(state: Any) -> Words:
        values = values_of(states, int(state)).items()
        return {
            name: value if states.component(name).labels is None
            else states.component(name).label(value)
            for name, value in values
        }  # fmt: skip

    return words
