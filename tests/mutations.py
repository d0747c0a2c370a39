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
COPIED = (
    "src",
    "tests",
    "benchmarks",
    "examples",
    "docs",
    "pyproject.toml",
    "conftest.py",
    "README.md",
)
PACKAGE = Path("src/curricle")
COMPILED = ("tasks/", "planning/", "learning/")
"""Where loops are compiled. Numba's disk cache would not notice a change in what they call."""
LIMIT = 300
"""Seconds of processor time that tests of a changed library may take: endless loops are caught."""
TABULATE = "tests/unit/interop/test_tabulate.py"
ACTING = "tests/unit/test_acting.py"
TABLES = "tests/unit/interop/test_gymnasium.py"


class Mutation(NamedTuple):
    """One mistake: in `file` of the package, `old` becomes `new`; `tests` should then fail."""

    name: str
    file: str
    old: str
    new: str
    tests: tuple[str, ...]

    def applied(self, text: str) -> str:
        """Return the file's text with the mistake in it."""
        if (count := text.count(self.old)) != 1:
            raise ValueError(f"{self.name}: {self.file} has {self.old!r} {count} times, not once")
        return text.replace(self.old, self.new)


# fmt: off
MUTATIONS = [
    Mutation("indices are converted again after their check", "tasks/mdp.py",
        "            object.__setattr__(self, name, numbers)", "            pass",
        ("tests/unit/test_frozen_arrays.py::test_what_is_kept_is_what_was_checked",)),
    Mutation("a mapping by name may map no pair", "transfer/by_components.py",
        "    if mapping.why_empty:", "    if not mapping:", ("tests/unit/test_mapping.py",)),
    Mutation("a link in the place of a lock followed", "study/store.py",
        "    if (path / LOCK).is_symlink():", "    if not path:",
        ("tests/unit/test_hostile_files.py::test_a_lock_that_is_a_link_is_not_followed",)),
    Mutation("an interval of a mean return leaves what returns can be", "statistics/intervals.py",
        "np.maximum(self.low, low)", "np.asarray(self.low)",
        ("tests/unit/show/test_figures.py::test_bands_stay_within_possible_returns",)),
    Mutation("the highest return takes what cannot happen", "planning/target.py",
        "possible, going = mdp.probability > 0,", "possible, going = mdp.probability >= 0,",
        ("tests/property/test_possible_returns.py::test_they_are_those_of_all_episodes",)),
    Mutation("a study file names Python's own library", "study_file/own_code.py",
        "    if first in sys.stdlib_module_names:", "    if not first:",
        ("tests/unit/test_hostile_files.py::test_pythons_own_library_is_refused",)),
    Mutation("a study file names any installed package", "study_file/own_code.py",
        "    if name not in SAFE and not any(", "    if not name and not any(",
        ("tests/unit/test_hostile_files.py::test_an_installed_package_is_named_where_it_is_allowed",)),
    Mutation("what an interrupted loop learnt is a result", "learning/trainers.py",
        "        if seed.record.halted[0]:", "        if not seed:",
        ("tests/unit/test_interrupts.py::test_what_was_halted_is_no_result",)),
    Mutation("a folder that was moved is made again", "study/store.py",
        "                (self.path / STUDY).stat()", "                str(self.path)",
        ("tests/unit/test_hostile_files.py::test_a_folder_that_is_moved_while_a_run_writes_ends_it",)),
    Mutation("truncation treated as termination", "learning/general_loop.py",
        "        if not terminated:\n            if looks_ahead",
        "        if not terminated and length < course.limit:\n            if looks_ahead",
        ("tests/unit/test_published_mistakes.py::test_a_time_limit_is_not_a_termination",)),
    Mutation("truncation treated as termination, fast loop", "learning/q_learning.py",
        "if not terminated:\n                    after = as_learnt(beside",
        "if not (terminated or step + 1 == last):\n                    after = as_learnt(beside",
        ("tests/unit/test_published_mistakes.py::test_a_time_limit_is_not_a_termination",)),
    Mutation("an action that is not available explored", "learning/learners.py",
        "drawn_among_available(OpenValues(values), n_actions, row, action, bits)", "action",
        ("tests/oracle/test_available_actions_oracle.py::test_learners",)),
    Mutation("an unavailable action redrawn by the bits of its outcome", "tasks/models.py",
        "integers(splitmix64(~bits), count)", "integers(splitmix64(bits), count)",
        ("tests/unit/test_available_actions.py::test_a_redrawn_action_says_nothing_about_its_outcome",)),
    Mutation("an unavailable action has outcomes of its own", "tasks/mdp.py",
        "frozen(duplicated(self.outcome_row, available))", "self.outcome_row",
        ("tests/oracle/test_available_actions_oracle.py::test_planning_chooses_among_available_actions",)),
    Mutation("a value of an action that a source lacks is read", "transfer/mapping.py",
        "np.where(nothing & (index >= 0), UNMAPPED, index)", "index",
        ("tests/unit/test_available_actions.py::test_a_source_knows_nothing_of_actions_that_it_lacks",)),
    Mutation("ties of the general loop drawn at once", "learning/general_loop.py",
        "tie = tables.ties[state] if tables.ties.shape[0] > 0 else splitmix64(counter)",
        "tie = splitmix64(counter)",
        ("tests/property/test_theorems_of_learning.py::test_nothing_added_changes_nothing",)),
    Mutation("a tie never drawn again", "learning/general_loop.py",
        "return (old if old > new else new) >= highest(values, ONLY_ROW)", "return False",
        ("tests/property/test_theorems_of_learning.py::test_nothing_added_changes_nothing",)),
    Mutation("values under a changing potential handed on", "learning/potential.py",
        "return len(self.frame_steps) > 1 or self.weight.first != self.weight.last", "return False",
        ("tests/property/test_portfolio_properties.py::test_values_that_contain_what_shaping_added_say_so",)),
    Mutation("sign of the shaping term", "learning/general_loop.py",
        "return discount * next_potential - carried, next_potential",
        "return carried - discount * next_potential, next_potential",
        ("tests/unit/test_published_mistakes.py::test_a_cut_episode_keeps_the_potential_of_its_last_state",
         "tests/property/test_theorems.py::test_learnt_shaping_rewards_sum_to_nothing_but_the_start")),
    Mutation("phi of a terminal state not 0", "learning/potential.py",
        "np.where(ends, 0.0, values)", "values.copy()",
        ("tests/unit/test_published_mistakes.py::test_a_potential_never_reaches_terminal_rows",
         "tests/unit/test_published_mistakes.py::test_a_state_potential_is_zero_in_terminal_states_in_every_frame")),
    Mutation("time to threshold above, not at", "statistics/curves.py",
        "window) >= threshold", "window) > threshold", ("tests/unit/test_curves.py",)),
    Mutation("os.replace dropped", "files.py",
        "os.replace(temporary, path)", "path.write_bytes(content)", ("tests/unit/test_files.py",)),
    Mutation("os.fsync dropped", "files.py",
        "os.fsync(file.fileno())  #", "pass  #", ("tests/unit/test_files.py",)),
    Mutation("charge_source off by one", "statistics/curves.py",
        "transfer.source_steps[:, np.newaxis]\n    training",
        "transfer.source_steps[:, np.newaxis] + 1\n    training",
        ("tests/unit/test_curves.py",)),
    Mutation("a source that teaches nothing is paid", "statistics/curves.py",
        "if gift > 0:", "if gift > 0 and False:",
        ("tests/property/test_statistics_properties.py::test_a_source_that_teaches_nothing_never_gains",)),
    Mutation("settled at the floor", "learning/stopping.py",
        "not recent_return(greedy, checkpoint) <= rule.floor", "greedy[0] == greedy[0]",
        ("tests/unit/test_settled_sources.py::test_a_return_that_fell_to_the_floor_has_not_settled",)),
    Mutation("agreement with nothing learnt", "learning/q_learning.py",
        "agreement = 1.0 - apart / beside.spread", "agreement = 1.0",
        ("tests/oracle/test_optimism_oracle.py",)),
    Mutation("two potentials by hand that count as one", "comparison/plan.py",
        " or by_hand is not other.node.potential", "",
        ("tests/unit/test_written_potentials.py",)),
    Mutation("a potential by hand that a source hides", "transfer/potential.py",
        "    if sources:\n        raise CurriculumError(\n            f\"a task's",
        "    if False:\n        raise CurriculumError(\n            f\"a task's",
        ("tests/unit/test_written_potentials.py",)),
    Mutation("a control that is not negated", "comparison/controls.py",
        "phi.rescaled(-1.0)", "phi.rescaled(1.0)",
        ("tests/unit/test_controls.py::test_controls_change_the_values_of_phi_alone",
         "tests/unit/test_controls.py::test_knowing_the_optimum_pays_and_its_negation_does_not")),
    Mutation("largest upper bound of several rivals", "comparison/verdicts.py",
        "low, high = bounds.min(axis=1).tolist()", "low, high = bounds[0].min(), bounds[1].max()",
        ("tests/unit/test_verdicts.py::test_the_gain_over_several_rivals_has_the_smallest_of_their_bounds",)),
    Mutation("a constant that learns with its curriculum's shaping", "comparison/opponents.py",
        "curriculum.replace(target, shaping=QInitialisation())", "curriculum",
        ("tests/unit/test_opponents.py",)),
    Mutation("constants of one curriculum are opponents of another", "comparison/measures.py",
        "curriculum = self.arms[name].curriculum or name", "curriculum = next(iter(self.controls))",
        ("tests/unit/test_opponents.py::test_arms_with_one_potential_share_their_constants",)),
    Mutation("finalists of a choice are judged on seeds that they were chosen on",
        "comparison/choice.py",
        "seeds, first = tuple(range(first, first + further)), first + further",
        "seeds = tuple(range(first, first + further))",
        ("tests/unit/test_choice.py::test_each_round_keeps_the_better_half_on_further_seeds",)),
    Mutation("free steps saved are charged in the report", "comparison/sentences.py",
        "arms.times(arm, strong=False)", "arms.times(arm)",
        ("tests/unit/show/test_findings.py",)),
    Mutation("steps that were never taken bound the share saved", "comparison/verdicts.py",
        "_smallest_gain(rows[complete])", "_smallest_gain(rows)",
        ("tests/unit/test_verdicts.py::test_only_steps_that_were_all_taken_bound_a_share_from_above",)),
    Mutation("window of several studies beyond the budget", "study/results.py",
        "window = min(first.window, budget // first.eval_freq + 1)", "window = first.window",
        ("tests/unit/test_study_reading.py::test_a_window_ends_with_the_smallest_budget",)),
    Mutation("ROUNDING times 1000", "statistics/curves.py",
        "ROUNDING = 1e-7", "ROUNDING = 1e-4",
        ("tests/unit/test_comparison.py::test_a_gain_within_rounding_is_none",)),
    Mutation("cost estimate times 100", "comparison/cost.py",
        "seconds = seeds * ", "seconds = 100 * seeds * ", ("tests/unit/test_cost.py",)),
    Mutation("a stream shared between seeds", "learning/run.py",
        "stream_start(settings[k].seed, stream)", "stream_start(settings[0].seed, stream)",
        ("tests/unit/test_published_mistakes.py::test_equal_seeds_agree_and_different_seeds_differ",)),
    Mutation("trials that are not seeded", "study_file/vary.py",
        "rng=tuning.seed", "rng=None",
        ("tests/unit/test_tuning.py::test_another_seed_tries_other_settings",)),
    Mutation("scratch not swept", "study_file/vary.py",
        "(*scratches.items(), *arms.items()):", "arms.items():",
        ("tests/unit/test_config_sweeps.py",)),
    Mutation("the lock not taken", "study/store.py",
        "lock.acquire(timeout=PATIENCE)", "pass",
        ("tests/unit/test_study_folder.py::test_only_one_process_works_on_a_study",)),
    Mutation("maximum for minimum", "transfer/aggregate.py",
        "np.fmin.reduce(_checked(potentials)", "np.fmax.reduce(_checked(potentials)",
        ("tests/unit/test_potential.py::test_a_source_that_knows_nothing_is_skipped",)),
    Mutation("bootstrapping without discount", "learning/q_learning.py",
        "target += discount * after", "target += after",
        ("tests/unit/test_published_mistakes.py::test_a_time_limit_is_not_a_termination",
         "tests/oracle/test_learn_oracle.py::test_learner_equals_the_naive_one")),
    Mutation("double Q-learning with one table", "learning/general_loop.py",
        "q[SECOND - table, next_state, best]", "q[table, next_state, best]",
        ("tests/oracle/test_learn_oracle.py::test_learner_equals_the_naive_one",)),
    Mutation("unmapped treated as ended", "transfer/mapping.py",
        "np.where(index == UNMAPPED, unmapped_value, shift)",
        "np.where(index == index, shift, unmapped_value)",
        ("tests/unit/test_mapping.py",)),
    Mutation("patience of a stopping rule ignored", "learning/stopping.py",
        "range(checkpoint + 1 - rule.patience, checkpoint + 1):\n        if not (curve",
        "range(checkpoint, checkpoint + 1):\n        if not (curve",
        ("tests/unit/test_stopping_rules.py",)),
    Mutation("Holm's p-values not monotone", "statistics/hypothesis_tests.py",
        "np.maximum.accumulate(scaled)", "scaled",
        ("tests/property/test_statistics_properties.py::test_holm_rejects_what_its_rule_says",)),
    Mutation("a forecast of another aggregate", "comparison/trial.py",
        "aggregate=function)", "aggregate=usual)",
        ("tests/unit/test_forecast.py::test_custom_aggregates_have_rows_too",)),
    Mutation("headroom below the target's own learner alone", "comparison/measures.py",
        "self.returns[self.best_opponent(name)].mean()", "self.returns[SCRATCH].mean()",
        ("tests/unit/test_forecast.py::test_a_forecast_begins_with_what_the_best_learner_without_a_source_leaves",)),
    Mutation("a trial with the random numbers of the experiment", "comparison/trial.py",
        "name + STREAM", "name",
        ("tests/unit/test_forecast.py::test_no_seed_of_a_trial_draws_what_a_seed_of_the_experiment_draws",)),
    Mutation("candidates that differ in their start count as one", "candidates/candidates.py",
        "np.allclose(start, other_start, rtol=0, atol=ROUNDING)", "True",
        ("tests/unit/test_source_candidates.py::test_hazards_are_removed_together_and_one_by_one",)),
    Mutation("candidates that are one task count as two", "candidates/candidates.py",
        "partitions = refined(", "return False\n    partitions = refined(",
        ("tests/unit/test_source_candidates.py::test_a_renumbered_target_is_no_candidate",)),
    Mutation("of ties always the first", "planning/greedy.py",
        "skipped = integers(bits * MULTIPLIER, ties)", "skipped = np.uint64(0)",
        ("tests/oracle/test_greedy_actions.py::test_every_tie_is_drawn_equally_often",)),
    Mutation("a snapshot of the wrong step", "learning/record.py",
        "record.snapshot_at[i] == number:", "record.snapshot_at[i] == number + 1:",
        ("tests/unit/test_stopping_rules.py::test_snapshots_hold_the_policy_at_their_steps",)),
    Mutation("a slip that goes the intended way too", "tasks/rooms.py",
        "np.where(np.eye(4, dtype=bool), 1 - self.slip, self.slip / 3)",
        "np.where(np.eye(4, dtype=bool), 1 - self.slip * 3 / 4, self.slip / 4)",
        ("tests/unit/test_rooms.py::test_moves_slip_as_in_the_drawing",)),
    Mutation("the river's large reward on every way out of the last state", "tasks/exploration.py",
        "reward[-1, 1] = self.right_reward", "reward[-1, :] = self.right_reward",
        ("tests/unit/test_exploration.py::test_the_paper_s_figure",)),
    Mutation("a slip in DeepSea that costs nothing", "tasks/exploration.py",
        "np.stack([paid] * ways, axis=-1)", "np.stack([paid] + [paid * 0] * (ways - 1), axis=-1)",
        ("tests/unit/test_exploration.py::test_every_dive_is_as_in_bsuite_and_slips_go_straight_down",)),
    Mutation("a lock that opens with any key", "tasks/rooms.py",
        "held[:, :keys].all(axis=1)", "held[:, :keys].any(axis=1)",
        ("tests/unit/test_rooms.py::test_a_lock_needs_its_keys",)),
    Mutation("random mazes with cells that have no way to the treasure", "tasks/gridworld.py",
        "return bool(joined) and all(joined)", "return any(joined)",
        ("tests/property/test_random_mazes.py::test_every_free_cell_has_a_way_to_the_treasure",)),
    Mutation("a taxi that drives through walls", "tasks/toy_text.py",
        "right != 0 for", "right < 0 for",
        ("tests/unit/test_toy_text_tasks.py::test_the_taxi_is_that_of_gymnasium",)),
    Mutation("ways to the goal through terminal states", "tasks/start_states.py",
        "steps_to(mdp, wanted, wanted | ~mdp.terminal)", "steps_to(mdp, wanted)",
        ("tests/property/test_start_states.py::test_distances_are_those_of_breadth_first_search",)),
    Mutation("visits of steps after the time limit", "planning/solution.py",
        "is None else mdp.time_limit):", "is None else mdp.time_limit + 1):",
        ("tests/property/test_start_states.py::test_visits_are_those_of_every_step_added_up",)),
    Mutation("a second predator that nobody reads", "tasks/pursuit.py",
        "range(len(names) if len(names) > len(source_names) else 1)", "range(1)",
        ("tests/unit/test_family_mappings.py::test_two_predators_read_one_as_in_the_paper",)),
    Mutation("steps of a tabulation are not repeated", "interop/search.py",
        "self._check_repeated(first, self._arrival(again, action), action)\n        # Where",
        "# Where",
        (f"{TABULATE}::test_a_step_is_repeated_from_its_state",)),
    Mutation("a reset may ignore its seed", "interop/search.py",
        "if not same_observation(observed, stepper.look(reached)[0]):", "if False:",
        (f"{TABULATE}::test_refusals_are_one_sentence",)),
    Mutation("a level that is reset again has the objects of the new reset", "interop/minigrid.py",
        "self.level = None  # attributes", "pass  # attributes",
        (f"{TABULATE[:-3]}_minigrid.py::test_a_level_may_be_reset_again",)),
    Mutation("a tabulation goes on from truncated states", "interop/search.py",
        "not (reached.terminated or reached.truncated)", "not reached.terminated",
        (f"{TABULATE}::test_a_clock_of_its_own_is_part_of_a_state_and_truncation_is_no_end",)),
    Mutation("states that look alike may lead apart", "interop/search.py",
        "if self._tries > 1 and self._led.setdefault(pair, led) != led:", "if False:",
        (f"{TABULATE}::test_states_that_look_alike_must_lead_alike",)),
    Mutation("a state that ended is the same as one that did not", "interop/search.py",
        "name = reached.key, reached.terminated", "name = reached.key, False",
        (f"{TABULATE}::test_the_same_state_ended_and_not_ended_is_two",)),
    Mutation("a step of a subclass is ignored", "interop/states.py",
        "getattr(type(env), name) is getattr(kind, name) and name not in vars(env)",
        "name not in vars(env)",
        (f"{TABLES}::test_what_a_table_does_not_describe_is_live",)),
    Mutation("a step that was replaced is ignored", "interop/states.py",
        " and name not in vars(env)", "",
        (f"{TABLES}::test_what_a_table_does_not_describe_is_live",)),
    Mutation("an environment whose step was replaced is made again without it",
        "interop/gymnasium.py",
        "                _check_unchanged(env, make)", "                pass",
        (f"{TABLES}::test_an_environment_whose_step_was_replaced_cannot_be_made_again",)),
    Mutation("the order in which states were found is read by name", "transfer/by_components.py",
        "if component.arbitrary or origin.arbitrary:",
        "if component.arbitrary and origin.arbitrary:",
        (f"{TABULATE}::test_states_in_the_order_of_discovery_are_never_mapped_by_name",)),
    Mutation("one of several resets is called exact", "interop/search.py",
        "len({*self.first}) > 1 or not all(starts)", "len({*self.first}) > 1",
        (f"{TABULATE}::test_resets_that_differ_are_said_to_be_some_of_several",)),
    Mutation("draws from global generators are no draws", "interop/tabulation.py",
        "if source is world and drawn():", "if False:",
        (f"{TABULATE}::test_draws_from_global_generators_are_repeated_and_given_back",)),
    Mutation("a MiniGrid step is repeated at the same time", "interop/states.py",
        "return int(number * 0.618034 % 1 * max(1, end - 1))", "return 0",
        ("tests/unit/interop/test_tabulate_minigrid.py::test_what_depends_on_the_time_is_refused",)),
    Mutation("a reward of a MiniGrid subclass is replaced by 1", "interop/minigrid.py",
        "if type(base)._reward is not usual or", "if",
        ("tests/unit/interop/test_tabulate_minigrid.py::test_a_reward_of_a_subclass_is_kept",)),
    Mutation("states with different rewards are made one", "interop/tabulation.py",
        " * len(different) + rewards.reshape(tables.reward.shape)", "",
        (f"{TABULATE}::test_observations_that_several_states_show_show_none",)),
    Mutation("a compiled view keeps the colours that objects had", "tasks/minigrid_view.py",
        ", *map(COLOUR, self.things)", "",
        ("tests/property/test_minigrid_view.py"
         "::test_any_grid_looks_as_by_minigrid_before_and_after_changes",)),
    Mutation("memory of episodes that have ended", "deep/networks.py",
        "part[:, kept] for part in memory", "part[:, : len(running)] for part in memory",
        (f"{ACTING}::test_each_episode_keeps_its_own_memory_when_others_end",)),
    Mutation("masks of environments whose episodes have ended", "deep/networks.py",
        "for k in running]", "for k in range(len(running))]",
        (f"{ACTING}::test_masks_are_of_the_environments_that_are_still_running",)),
    Mutation("steps of models that no arm pays for", "curriculum/curriculum.py",
        "return self.task.cost  # type", "return 0  # type",
        ("tests/deep/test_miniatures.py"
         "::test_a_comparison_charges_the_models_once_and_has_a_placebo",)),
    Mutation("statistics of the observations before the last", "deep/networks.py",
        "mean.add_(shift * weight)", "mean.add_(shift * weight / 2)",
        ("tests/deep/test_setups.py::test_statistics_are_those_of_vec_normalize",)),
    Mutation("values in units of normalised rewards", "deep/networks.py",
        "values = values * float(self._standardized.running_reward)", "pass",
        ("tests/deep/test_setups.py::test_a_network_keeps_its_statistics_wherever_it_goes",)),
    Mutation("networks with actions that count from 1", "deep/learner.py",
        'if np.any(getattr(part, "start", 0)):',
        'if kind == "Observation" and np.any(getattr(part, "start", 0)):',
        (f"{ACTING}::test_networks_take_no_spaces_that_do_not_count_from_0",)),
    Mutation("a model's actions counted from 0 in tables that count from 1",
        "interop/tabulated_task.py",
        "if any(part.low for part in self.actions.components):", "if not self.actions.components:",
        (f"{ACTING}::test_actions_of_tables_count_from_0_where_a_model_is_read",)),
    Mutation("an arm whose sources took more than the total that is compared", "study/results.py",
        "    if most > total:\n", "    if most > 2 * total + 10_000:\n",
        ("tests/unit/test_study_reading.py::test_the_smallest_total_must_leave_steps_for_every_target",)),
    Mutation("a curve read from its end", "comparison/measures.py",
        "if spent.max() > total:", "if spent.min() < 0:",
        ("tests/unit/test_study_reading.py::test_the_smallest_total_must_leave_steps_for_every_target",)),
    Mutation("schedules over another total compared", "study/results.py",
        'if arm.depends_on_total == "" or study.record.total == total or name in study.failed:',
        "if total:",
        ("tests/unit/test_study_reading.py::test_what_depends_on_the_total_is_compared_at_one_alone",)),
    Mutation("a verdict while seeds are missing", "study/results.py",
        "if lacking or len(seeds) < len(planned):", "if lacking:",
        ("tests/unit/test_study_reading.py::test_while_seeds_are_missing_there_is_no_verdict",)),
    Mutation("a p-value while seeds are missing", "comparison/verdicts.py",
        "[math.nan] * len(apart) if interim else _p_values", "_p_values",
        ("tests/unit/test_verdicts.py::test_seeds_to_come_withhold_every_verdict",)),
    Mutation("a difference shown beside an interval that holds 0", "comparison/verdicts.py",
        "    if p >= SIGNIFICANT or not gain.low", "    if p >= SIGNIFICANT or gain.low",
        ("tests/unit/test_verdicts.py::test_no_difference_is_shown_beside_an_interval_that_holds_0",)),
    Mutation("a bound of mappings at another discount than the task's", "transfer/pair.py",
        "s if tables(task).discount < 1 else solve(task)", "s",
        ("tests/property/test_found_mappings.py::test_no_bound_is_exceeded_by_the_exact_values_of_two_tasks",)),
    Mutation("pairs of different values in a homomorphism", "transfer/bisimulation.py",
        "apart(index, *solutions) <= error", "apart(index, *solutions) < np.inf",
        ("tests/property/test_found_mappings.py::test_a_homomorphism_maps_no_pairs_whose_values_differ",)),
    Mutation("F that is off by its rounding is called safe", "certificate/certification.py",
        "reach = 2 * off * longest_episode(self.reachable.mdp)", "reach = 2 * EPSILON * largest",
        ("tests/property/test_certificate_enumeration.py::test_no_reward_is_safe_that_changes_what_is_optimal",)),
    Mutation("a tie that is not proven is called safe", "certificate/certification.py",
        "(fits and tied_exactly(self.reachable, self.unshaped, self.task.optimal)):", "fits:",
        ("tests/property/test_certificate_enumeration.py::test_no_reward_is_safe_that_changes_what_is_optimal",)),
    Mutation("rewards below the normal numbers have no error", "planning/solution.py",
        "rounding += unit / EPSILON * TINIEST", "pass",
        ("tests/oracle/test_proven_errors.py::test_rewards_below_the_normal_numbers_have_an_error_too",)),
    Mutation("shortest paths without an error", "planning/solution.py",
        "(max(lower, upper) + rounding)", "0.0",
        ("tests/oracle/test_proven_errors.py::test_stochastic_shortest_paths_are_within_their_bound",)),
    Mutation("a mapping of names with another value forgets what it knows",
        "transfer/mapping.py",
        "replace(self, unmapped_value=value)",
        "replace(self, unmapped_value=value, knows_target=False)",
        ("tests/property/test_found_mappings.py::test_what_a_mapping_knows_survives_whatever_is_done_with_it",)),
    Mutation("a search by names is said to know nothing of the target", "transfer/search.py",
        "yield mapping.knowing_target(), proposal.how", "yield mapping, proposal.how",
        ("tests/unit/test_mappings_that_know_the_target.py::test_what_a_search_found_knows_the_target_and_what_a_hand_made_does_not",)),
    Mutation("a mapping into a copy of the target hides that it was found",
        "curriculum/curriculum.py",
        "states.size >= whole.states.size", "states.size > whole.states.size",
        ("tests/unit/test_mappings_that_know_the_target.py::test_a_copy_between_does_not_hide_it",)),
    Mutation("a mapping is taken though the dynamics disagree", "transfer/search.py",
        "        and scores.dynamics_error <= MOST_APART\n", "",
        ("tests/unit/test_mappings_that_know_the_target.py::test_a_mapping_is_refused_where_the_dynamics_disagree",)),
    Mutation("a found mapping pays by what its source knows", "comparison/verdicts.py",
        '"mapping" if self.knows_target else "knowledge"', '"knowledge"',
        ("tests/unit/test_mappings_that_know_the_target.py::test_it_stands_in_the_verdict_whatever_the_verdict_is",)),
    Mutation("a study forgets that a mapping was found", "study/results.py",
        "        knows_target=arm.knows_target,\n", "",
        ("tests/unit/test_mappings_that_know_the_target.py::test_it_is_kept_in_the_folder_of_a_study",)),
    Mutation("a placebo is judged by paired differences", "comparison/measures.py",
        "looks=self.looks, placebos=placebos", "looks=self.looks",
        ("tests/unit/test_controls.py::test_knowing_the_optimum_pays_and_its_negation_does_not",)),
    Mutation("an audit calls every paying arm one that knows", "study/auditing.py",
        ' if sides[1].reasons[name].why in ("knowledge", "mapping")', "",
        ("tests/unit/test_audit.py::test_only_arms_that_gain_more_than_their_placebos_pay_by_what_they_know",)),
    Mutation("the key of a crop forgets its maze", "study/arms.py",
        "if k not in SETTINGS} for of in wholes]", "if k in ()} for of in wholes]",
        ("tests/unit/test_resuming.py::test_the_key_of_a_part_changes_with_its_whole",)),
    Mutation("compared studies have the budget of the first", "study/results.py",
        "budget = min(study.record.budget or 0 for study in studies)", "budget = first.budget or 0",
        ("tests/unit/test_study_reading.py::test_what_depends_on_the_total_is_compared_at_one_alone",)),
    Mutation("sampled rewards are multiplied by their probability", "interop/tabulation.py",
        "        reward = earned / chance\n", "        reward = earned\n",
        ("tests/unit/interop/test_tabulate.py::test_estimates_say_so_and_come_close",)),
    Mutation("decisions go on after the steps of a seed", "learning/stopping.py",
        "if used is not None and step > used:", "if used is not None and step < 0:",
        ("tests/unit/test_stopping_rules.py::test_decisions_end_with_the_steps_that_a_seed_took",)),
    Mutation("a reset counts as a step of w(t)", "interop/potential_shaping.py",
        "+= sum(episode is not None for episode in running)", "+= len(running)",
        ("tests/unit/interop/test_potential_shaping.py::test_a_reset_is_no_step_of_a_weight_that_changes",)),
    Mutation("a member of a portfolio is dropped", "learning/portfolio.py",
        "if shares[member] > 0.0 else", "if shares[member] > 0.1 else",
        ("tests/property/test_portfolio_properties.py::test_each_member_acts_for_its_share_of_the_steps",)),
    Mutation("the informed optimist starts at phi", "learning/portfolio.py",
        "(self.margin * (high - low), lowest", "(0.0 * (high - low), lowest",
        ("tests/oracle/test_portfolio_oracle.py::test_a_portfolio_equals_the_naive_one",)),
    Mutation("R-max plans with pairs that were tried too seldom", "learning/model_based.py",
        "if visits >= learnt.min_visits:", "if visits > 0:",
        ("tests/oracle/test_model_based_oracle.py::test_values",)),
]
# fmt: on


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
