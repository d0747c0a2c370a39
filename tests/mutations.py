"""Mistakes that the fast tests must catch: each is made in a copy of the library, and tests run.

Usage: python tests/mutations.py [WORDS] [--jobs 2]. WORDS select the mutations whose names contain
them. Prints a line for each, `caught` or `survived`, and fails if one survived. It stops with an
error if a text to be changed is not in the library exactly once, or if tests fail without a change.
"""

import argparse
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[1]
COPIED = ("src", "tests", "examples", "docs", "pyproject.toml", "conftest.py", "README.md")
PACKAGE = Path("src/curricle")
COMPILED = ("tasks/", "planning/", "learning/")
"""Where loops are compiled. Numba's disk cache would not notice a change in what they call."""
LIMIT = 300
"""Seconds of processor time that tests of a changed library may take: endless loops are caught."""


TABULATE = "tests/unit/interop/test_tabulate.py"


class Mutation(NamedTuple):
    """One mistake: in `file` of the package, `old` becomes `new`; `tests` should then fail."""

    name: str
    file: str
    old: str
    new: str
    tests: tuple[str, ...]

    def applied(self, text: str) -> str:
        """Return the file's text with the mistake in it."""
        if (found := text.count(self.old)) != 1:
            raise ValueError(f"{self.name}: {self.file} has {self.old!r} {found} times, not once")
        return text.replace(self.old, self.new)


MUTATIONS = [
    Mutation(
        "truncation treated as termination",
        "learning/general_loop.py",
        "        if not terminated:\n            acting_values",
        "        if not terminated and length < limit:\n            acting_values",
        ("tests/unit/test_published_mistakes.py::test_a_time_limit_is_not_a_termination",),
    ),
    Mutation(
        "truncation treated as termination, fast loop",
        "learning/q_learning.py",
        "if not terminated:",
        "if not terminated and step + 1 != last:",
        ("tests/unit/test_published_mistakes.py::test_a_time_limit_is_not_a_termination",),
    ),
    Mutation(
        "sign of the shaping term",
        "learning/general_loop.py",
        "return discount * there - here, there",
        "return here - discount * there, there",
        (
            "tests/unit/test_published_mistakes.py::test_a_cut_episode_keeps_the_potential_of_its_last_state",
            "tests/property/test_theorems.py::test_learnt_shaping_rewards_sum_to_nothing_but_the_start",
        ),
    ),
    Mutation(
        "phi of a terminal state not 0",
        "learning/potential.py",
        "np.where(ends, 0.0, values)",
        "values.copy()",
        (
            "tests/unit/test_published_mistakes.py::test_a_potential_never_reaches_terminal_rows",
            "tests/unit/test_published_mistakes.py::test_a_state_potential_is_zero_in_terminal_states_in_every_frame",
        ),
    ),
    Mutation(
        "time to threshold above, not at",
        "statistics/thresholds.py",
        "window) >= threshold",
        "window) > threshold",
        (
            "tests/unit/test_metrics.py",
            "tests/unit/test_times.py",
        ),
    ),
    Mutation(
        "os.replace dropped",
        "files.py",
        "os.replace(temporary, path)",
        "path.write_bytes(content)",
        ("tests/unit/test_files.py",),
    ),
    Mutation(
        "os.fsync dropped",
        "files.py",
        "os.fsync(file.fileno())  #",
        "pass  #",
        ("tests/unit/test_files.py",),
    ),
    Mutation(
        "charge_source off by one",
        "statistics/curves.py",
        "transfer.source_steps[:, np.newaxis]\n    rows",
        "transfer.source_steps[:, np.newaxis] + 1\n    rows",
        ("tests/unit/test_metrics.py",),
    ),
    Mutation(
        "a control that is not negated",
        "comparison/controls.py",
        "StateActionPotential(phi.task, -phi.values)",
        "StateActionPotential(phi.task, phi.values)",
        (
            "tests/unit/test_controls.py::test_controls_change_the_values_of_phi_alone",
            "tests/unit/test_controls.py::test_knowing_the_optimum_pays_and_its_negation_does_not",
        ),
    ),
    Mutation(
        "largest upper bound of several rivals",
        "comparison/verdicts.py",
        "high=float(np.min(",
        "high=float(np.max(",
        ("tests/unit/test_verdicts.py",),
    ),
    Mutation(
        "a fifth of a gain is nothing beside the rest",
        "comparison/verdicts.py",
        "SHARE = 0.1",
        "SHARE = 0.2",
        ("tests/unit/test_reasons.py",),
    ),
    Mutation(
        "free steps saved are charged in the report",
        "report/sections.py",
        "strong=measure not in WEAK",
        "strong=True",
        ("tests/unit/report/test_findings.py",),
    ),
    Mutation(
        "window of several studies beyond the budget",
        "study/results.py",
        "window = min(first.window, budget // first.eval_freq + 1)",
        "window = first.window",
        ("tests/unit/test_study_reading.py::test_a_window_ends_with_the_smallest_budget",),
    ),
    Mutation(
        "ROUNDING times 1000",
        "statistics/curves.py",
        "ROUNDING = 1e-7",
        "ROUNDING = 1e-4",
        ("tests/unit/test_comparison.py",),
    ),
    Mutation(
        "cost estimate times 100",
        "study/cost.py",
        "seconds = seeds * (",
        "seconds = 100 * seeds * (",
        ("tests/unit/test_cost.py",),
    ),
    Mutation(
        "a stream shared between seeds",
        "learning/training.py",
        "stream_start(each[k].seed, stream)",
        "stream_start(each[0].seed, stream)",
        (
            "tests/unit/test_published_mistakes.py::test_equal_seeds_agree_and_different_seeds_differ",
        ),
    ),
    Mutation(
        "a search that is not seeded",
        "study/tuning.py",
        "seed=tuning.seed, n_startup_trials",
        "n_startup_trials",
        ("tests/unit/test_tuning.py",),
    ),
    Mutation(
        "scratch not swept",
        "study/config/sweeps.py",
        'place[2] in ("learner", "storage")',
        "not place",
        ("tests/unit/test_config_sweeps.py",),
    ),
    Mutation(
        "the lock not taken",
        "study/store.py",
        "lock.acquire(timeout=PATIENCE)",
        "pass",
        ("tests/unit/test_study_folder.py::test_only_one_process_works_on_a_study",),
    ),
    Mutation(
        "maximum for minimum",
        "transfer/aggregation.py",
        "np.fmin.reduce(_given(potentials)",
        "np.fmax.reduce(_given(potentials)",
        ("tests/unit/test_aggregation.py",),
    ),
    Mutation(
        "bootstrapping without discount",
        "learning/q_learning.py",
        "target += discount * best[next_row]",
        "target += best[next_row]",
        (
            "tests/unit/test_published_mistakes.py::test_a_time_limit_is_not_a_termination",
            "tests/oracle/test_learn_oracle.py::test_learner_equals_the_naive_one",
        ),
    ),
    Mutation(
        "double Q-learning with one table",
        "learning/general_loop.py",
        "q[1 - table, next_state, best]",
        "q[table, next_state, best]",
        ("tests/oracle/test_learn_oracle.py::test_learner_equals_the_naive_one",),
    ),
    Mutation(
        "unmapped treated as ended",
        "transfer/mapping.py",
        "np.where(index == UNMAPPED, unmapped_value, shift)",
        "np.where(index == index, shift, unmapped_value)",
        ("tests/unit/test_mapping.py",),
    ),
    Mutation(
        "patience of a stopping rule ignored",
        "learning/stopping.py",
        "range(checkpoint + 1 - rule.patience, checkpoint + 1):\n        if not (greedy[i] >=",
        "range(checkpoint, checkpoint + 1):\n        if not (greedy[i] >=",
        ("tests/unit/test_stopping_rules.py",),
    ),
    Mutation(
        "Holm's p-values not monotone",
        "statistics/hypothesis_tests.py",
        "np.maximum.accumulate(scaled)",
        "scaled",
        ("tests/unit/test_hypothesis_tests.py",),
    ),
    Mutation(
        "a forecast of another aggregate",
        "comparison/candidates.py",
        "aggregate=function)",
        "aggregate=own)",
        (
            "tests/unit/test_forecast.py::test_custom_aggregates_have_rows_too",
            "tests/unit/test_forecast.py::test_the_table_holds_the_numbers",
        ),
    ),
    Mutation(
        "a trial with the random numbers of the experiment",
        "comparison/trial.py",
        "name + STREAM",
        "name",
        ("tests/unit/test_trial.py",),
    ),
    Mutation(
        "candidates that differ in their start count as one",
        "design/candidates.py",
        "np.allclose(start, other_start, rtol=0, atol=ROUNDING)",
        "True",
        ("tests/unit/test_source_candidates.py",),
    ),
    Mutation(
        "candidates that are one task count as two",
        "design/candidates.py",
        "mine, others = refined(",
        "return False\n    mine, others = refined(",
        ("tests/unit/test_source_candidates.py",),
    ),
    Mutation(
        "shortest paths that are not counted",
        "design/bottlenecks.py",
        "(1 + delta) / safe",
        "1 + delta",
        ("tests/property/test_source_candidates.py",),
    ),
    Mutation(
        "of ties always the first",
        "planning/greedy.py",
        "left = integers(bits * MULTIPLIER, ties)",
        "left = np.uint64(0)",
        ("tests/oracle/test_greedy_actions.py::test_every_tie_is_drawn_equally_often",),
    ),
    Mutation(
        "a snapshot of the wrong step",
        "learning/general_loop.py",
        "record.snapshot_at[i] == checkpoint:",
        "record.snapshot_at[i] == checkpoint + 1:",
        ("tests/unit/test_stopping_rules.py::test_snapshots_hold_the_policy_at_their_steps",),
    ),
    Mutation(
        "a slip that goes the intended way too",
        "tasks/four_rooms.py",
        "np.where(np.eye(4, dtype=bool), 1 - self.slip, self.slip / 3)",
        "np.where(np.eye(4, dtype=bool), 1 - self.slip * 3 / 4, self.slip / 4)",
        ("tests/unit/test_four_rooms.py::test_moves_slip_as_in_the_drawing",),
    ),
    Mutation(
        "the river's large reward on every way out of the last state",
        "tasks/river_swim.py",
        "reward[-1, 1] = self.right_reward",
        "reward[-1, :] = self.right_reward",
        ("tests/unit/test_river_swim.py::test_the_paper_s_figure",),
    ),
    Mutation(
        "a slip in DeepSea that costs nothing",
        "tasks/deep_sea.py",
        "[moved, fallen], [paid, paid]",
        "[moved, fallen], [paid, paid * 0]",
        ("tests/unit/test_deep_sea.py::test_slips_go_straight_down_and_pay_the_same",),
    ),
    Mutation(
        "a lock that opens with any key",
        "tasks/key_lock_pit.py",
        "            for key in keys:\n",
        "            for key in list(keys)[:0]:\n",
        ("tests/unit/test_key_lock_pit.py::test_a_lock_needs_its_keys",),
    ),
    Mutation(
        "a step of two for a carrier under a ceiling",
        "tasks/block_dude.py",
        "height + 1 + holding",
        "height + 1",
        ("tests/unit/test_block_dude.py::test_up_needs_room_above_the_step_and_more_with_a_block",),
    ),
    Mutation(
        "random mazes with cells that have no way to the treasure",
        "tasks/families/mazes.py",
        "return bool(free) and joined.keys() == free",
        "return bool(free) and bool(joined)",
        ("tests/property/test_random_mazes.py::test_every_free_cell_has_a_way_to_the_treasure",),
    ),
    Mutation(
        "a taxi that drives through walls",
        "tasks/taxi.py",
        "right != 0 for",
        "right < 0 for",
        ("tests/unit/test_toy_text_tasks.py::test_the_taxi_is_that_of_gymnasium",),
    ),
    Mutation(
        "ways to the goal through terminal states",
        "tasks/mdp.py",
        "    pairs = np.repeat(~mdp.terminal[:, None]",
        "    pairs = np.repeat((mdp.start > -1)[:, None]",
        ("tests/property/test_start_states.py::test_distances_are_those_of_breadth_first_search",),
    ),
    Mutation(
        "visits of steps after the time limit",
        "planning/solution.py",
        "is None else mdp.time_limit):",
        "is None else mdp.time_limit + 1):",
        ("tests/property/test_start_states.py::test_visits_are_those_of_every_step_added_up",),
    ),
    Mutation(
        "a second predator that nobody reads",
        "tasks/families/built_in.py",
        "range(len(own) if len(own) > len(others) else 1)",
        "range(1)",
        ("tests/unit/test_family_mappings.py::test_two_predators_read_one_as_in_the_paper",),
    ),
    Mutation(
        "steps of a tabulation are not repeated",
        "interop/tabulation/exploration.py",
        "self._check_repeated(first, self._arrival(again, action), action)\n            # Where",
        "# Where",
        (f"{TABULATE}::test_a_step_is_repeated_from_its_state",),
    ),
    Mutation(
        "a tabulation goes on from truncated states",
        "interop/tabulation/exploration.py",
        "(self.queued[state] or reached.terminated or reached.truncated)",
        "(self.queued[state] or reached.terminated)",
        (f"{TABULATE}::test_a_clock_of_its_own_is_part_of_a_state_and_truncation_is_no_end",),
    ),
    Mutation(
        "a state that ended is the same as one that did not",
        "interop/tabulation/exploration.py",
        "name = reached.key, reached.terminated",
        "name = reached.key, False",
        (f"{TABULATE}::test_the_same_state_ended_and_not_ended_is_two",),
    ),
    Mutation(
        "states with different rewards are made one",
        "interop/tabulation/tables.py",
        " * len(different) + rewards.reshape(tables.reward.shape)",
        "",
        (f"{TABULATE}::test_observations_that_several_states_show_show_none",),
    ),
    Mutation(
        "a bound of mappings at another discount than the task's",
        "transfer/task_pair.py",
        "s if tables(task).discount < 1 else solve(task)",
        "s",
        (
            "tests/property/test_found_mappings.py::test_no_bound_is_exceeded_by_the_exact_values_of_two_tasks",
        ),
    ),
    Mutation(
        "pairs of different values in a homomorphism",
        "transfer/bisimulation.py",
        "apart(index, *solutions) <= error",
        "apart(index, *solutions) < np.inf",
        (
            "tests/property/test_found_mappings.py::test_a_homomorphism_maps_no_pairs_whose_values_differ",
        ),
    ),
    Mutation(
        "distances below the difference of two values",
        "transfer/bisimulation.py",
        "np.maximum(states, abs(between)) + error",
        "states + error",
        (
            "tests/property/test_found_mappings.py::test_no_bound_is_exceeded_by_the_exact_values_of_two_tasks",
        ),
    ),
    Mutation(
        "F that is off by its rounding is called safe",
        "certificate/certification.py",
        "reach = 2 * off * _longest(met.mdp)",
        "reach = 2 * EPSILON * shaped.largest",
        (
            "tests/property/test_certificate_enumeration.py::test_no_reward_is_safe_that_changes_what_is_optimal",
        ),
    ),
    Mutation(
        "rewards below the normal numbers have no error",
        "planning/solution.py",
        "rounding += unit / EPSILON * TINIEST",
        "pass",
        (
            "tests/oracle/test_proven_errors.py::test_rewards_below_the_normal_numbers_have_an_error_too",
        ),
    ),
    Mutation(
        "shortest paths without an error",
        "planning/direct.py",
        "(max(lower, upper) + rounding)",
        "0.0",
        (
            "tests/oracle/test_proven_errors.py::test_stochastic_shortest_paths_are_within_their_bound",
        ),
    ),
]


# -- one after another, each job in a copy of its own ---------------------------------------------


class Job:
    """A copy of the repository in which libraries are changed and tests are run."""

    def __init__(self, folder: Path):
        self.folder = folder
        hidden = shutil.ignore_patterns("__pycache__", "_build", "generated")
        for name in COPIED:
            if (ROOT / name).is_dir():
                shutil.copytree(ROOT / name, folder / name, ignore=hidden)
            else:
                shutil.copy(ROOT / name, folder / name)

    def run(self, tests: tuple[str, ...], cache: str) -> subprocess.CompletedProcess[str]:
        """Run tests up to the first that fails, with compiled loops kept in the cache named."""
        environment = {
            **os.environ,
            "PYTHONPATH": str(self.folder / "src"),
            "PYTHONDONTWRITEBYTECODE": "1",
            "NUMBA_CACHE_DIR": str(self.folder / cache),
            "MPLBACKEND": "Agg",
            "CI": "1",  # Hypothesis draws the same examples every time
        }
        options = ["-x", "-n", "0", "--timeout", "0", "-p", "no:cacheprovider"]
        limited = ["sh", "-c", f'ulimit -t {LIMIT}; exec "$@"', "sh"]
        done = subprocess.run(
            [*limited, sys.executable, "-m", "pytest", *options, *tests],
            cwd=self.folder,
            env=environment,
            capture_output=True,
            text=True,
            timeout=20 * LIMIT,
            check=False,
        )
        if done.returncode in (-signal.SIGXCPU, -signal.SIGKILL):
            done = subprocess.CompletedProcess(done.args, 1, "FAILED (no end)\n", "")
        return done

    def check(self, mutations: list[Mutation]) -> Iterator[tuple[Mutation, str]]:
        """Yield which test caught each mutation, or nothing for one that survived."""
        tests = dict.fromkeys(test for mutation in mutations for test in mutation.tests)
        if tests and (done := self.run(tuple(tests), "cache")).returncode != 0:
            output = done.stdout + done.stderr
            raise RuntimeError(f"without a change these tests must pass:\n{output}")
        for number, mutation in enumerate(mutations):
            path = self.folder / PACKAGE / mutation.file
            text = path.read_text("utf-8")
            path.write_text(mutation.applied(text), "utf-8")
            compiled = mutation.file.startswith(COMPILED)
            done = self.run(mutation.tests, f"cache{number}" if compiled else "cache")
            path.write_text(text, "utf-8")
            if done.returncode not in (0, 1):
                raise RuntimeError(f"{mutation.name}: no test ran:\n{done.stdout}{done.stderr}")
            failed = re.search(r"^FAILED (.*?)( - |$)", done.stdout, re.MULTILINE)
            yield mutation, failed[1] if failed else "an error" if done.returncode else ""


def main(arguments: list[str]) -> int:
    """Run the mutations asked for and return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("words", nargs="*", help="only mutations whose names contain these words")
    parser.add_argument("--jobs", type=int, default=2, help="how many run side by side")
    asked = parser.parse_args(arguments)
    chosen = [m for m in MUTATIONS if all(word in m.name for word in asked.words)]
    for mutation in chosen:
        mutation.applied((ROOT / PACKAGE / mutation.file).read_text("utf-8"))
    caught = []

    def work(number: int) -> None:
        with tempfile.TemporaryDirectory(prefix="mutations-") as folder:
            for mutation, by in Job(Path(folder)).check(chosen[number :: asked.jobs]):
                print(f"{'caught' if by else 'SURVIVED':9} {mutation.name:50} {by}", flush=True)
                caught.append(bool(by))

    with ThreadPoolExecutor(asked.jobs) as pool:
        list(pool.map(work, range(asked.jobs)))
    print(f"{sum(caught)} of {len(caught)} mutations caught")
    return 0 if all(caught) else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
