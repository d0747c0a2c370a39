"""Keys, locks and pits: the rules on small maps, optima and counts by breadth-first search."""

from collections import deque
from functools import partial

import numpy as np
import pytest

from curricle import project, solve
from curricle.errors import TaskError
from curricle.tasks import KeyLockPit
from curricle.tasks.mdp import reachable_states
from tests.refusals import cases, check_refusal, check_values

NORTH, EAST, SOUTH, WEST, PICK_UP, UNLOCK = range(6)
WAYS = ((-1, 0), (0, 1), (1, 0), (0, -1))


def follow(task, *actions):
    """Return the rewards of actions, and the state they lead to, in words."""
    mdp = task.mdp
    (state,), paid = mdp.start_states, []
    for action in actions:
        assert not mdp.terminal[state]
        row = mdp.outcome_row[state, action]
        assert mdp.probability[row].tolist() == [1.0]
        paid.append(float(mdp.reward[row, 0]))
        state = mdp.next_state[row, 0]
    return paid, task.states.label(state), bool(mdp.terminal[state])


def test_the_rewards_of_the_literature():
    task = KeyLockPit("SKL")
    paid, where, ended = follow(task, PICK_UP, EAST, UNLOCK, PICK_UP, PICK_UP, EAST, UNLOCK)
    assert paid == [-10, -10, -10, 500, -10, -10, 1000]
    assert where == "row=0 column=2 key=held lock=open"
    assert ended


def test_pits_walls_and_maps_without_locks_or_keys():
    assert follow(KeyLockPit("SPK"), EAST) == ([-200], "row=0 column=1 key=lying", True)
    paid, where, ended = follow(KeyLockPit(["S#", "K."]), NORTH, EAST, WEST)
    assert (paid, where, ended) == ([-10] * 3, "row=0 column=0 key=lying", False)
    assert follow(KeyLockPit("SK"), EAST, PICK_UP) == ([-10, 500], "row=0 column=1 key=held", True)
    assert follow(KeyLockPit("SL"), EAST, UNLOCK)[0] == [-10, 1000]
    held = KeyLockPit("SKL", keys_held=True)
    assert follow(held, EAST, PICK_UP, EAST, UNLOCK)[0] == [-10, -10, -10, 1000]


def test_a_lock_needs_its_keys():
    task = KeyLockPit("SKLKL", needs=[[2], [1]])
    paid, where, _ = follow(task, EAST, PICK_UP, EAST, UNLOCK, EAST, EAST, UNLOCK)
    assert paid == [-10, 500, -10, -10, -10, -10, 1000]
    assert where == "row=0 column=4 key_1=held key_2=lying lock_1=locked lock_2=open"
    assert follow(KeyLockPit("SKLKL"), EAST, PICK_UP, EAST, UNLOCK)[0][-1] == -10


def search(lines):
    """Return by the papers' rules how many states can be met, the shortest way, the best return."""
    # Picking up and opening pay once each: the best return is that less 10 a move.
    cells = {(r, c): what for r, line in enumerate(lines) for c, what in enumerate(line)}
    keys = [cell for cell, what in cells.items() if what == "K"]
    locks = [cell for cell, what in cells.items() if what == "L"]
    (start,) = [cell for cell, what in cells.items() if what == "S"]
    first = (start, frozenset(), frozenset())
    steps, waiting, shortest = {first: 0}, deque([first]), None
    while waiting:
        here, held, opened = one = waiting.popleft()
        if len(opened) == len(locks):
            shortest = steps[one] if shortest is None else shortest
            continue
        if cells[here] == "P":
            continue
        after = []
        for down, right in WAYS:
            there = (here[0] + down, here[1] + right)
            after.append((there if cells.get(there, "#") != "#" else here, held, opened))
        if here in keys:
            after.append((here, held | {here}, opened))
        if here in locks and len(held) == len(keys):
            after.append((here, held, opened | {here}))
        for other in after:
            if other not in steps:
                steps[other] = steps[one] + 1
                waiting.append(other)
    useful = len(keys) + len(locks)
    best = (
        None if shortest is None else 500 * len(keys) + 1000 * len(locks) - 10 * (shortest - useful)
    )
    return len(steps), shortest, best


MAPS = {
    "room": KeyLockPit().map,
    "two keys": ("S.#K", ".P..", "KL.."),
    "two locks": ("SPL", "K..", "..L"),
    "behind a wall": ("S.K", "###", "..L"),
}


@pytest.mark.parametrize("name", MAPS)
def test_counts_and_optima_agree_with_a_search(name):
    task = KeyLockPit(MAPS[name], discount=0.999, time_limit=None)
    met, shortest, best = search(MAPS[name])
    assert reachable_states(task.mdp).sum() == met
    if shortest is None:
        assert solve(task).values[task.mdp.start_states[0]] < 500
        return
    state, paid, policy = int(task.mdp.start_states[0]), [], solve(task).policy
    while not task.mdp.terminal[state]:
        row = task.mdp.outcome_row[state, int(policy[state].argmax())]
        paid.append(float(task.mdp.reward[row, 0]))
        state = int(task.mdp.next_state[row, 0])
    assert (len(paid), sum(paid)) == (shortest, best)


# By hand: n - 1 moves to the key in the north-west, 2 n - 4 past the pits to the lock, and 2 uses.
@pytest.mark.parametrize("size", [4, 6, 8, 11])
def test_the_optimum_of_a_room(size):
    task = KeyLockPit.room(size)
    met, shortest, best = search(task.map)
    assert shortest == 3 * size - 5 + 2
    assert best == 1500 - 10 * (3 * size - 5)
    assert met == task.states.size == 2 * size**2 + 1


def test_all_states_of_every_status_are_there_once():
    task = KeyLockPit(["SK.", "L#K", "P.L"], needs=[[1], [1, 2]])
    # Sets of locks that may be open: 1 without a key or with the second, 2 with the first, 4 with
    # both. In 8 cells each, but with all open only at one of the 2 locks.
    assert task.states.size == 8 * (1 + 1 + 2 + 4 - 1) + 2


def test_a_crop_keeps_coordinates_and_the_keys_that_it_has():
    task = KeyLockPit(["SK.L", "..K.", "L..."], needs=[[1, 2], [2]])
    part = task.crop(rows=(0, 2), columns=(2, 4))
    assert part.map == (".L", "K.")
    assert (part.origin, part.needs) == ((0, 2), ((1,),))
    assert part.states.decode()["column"].min() == 2
    assert task.crop(rows=(0, 1), columns=(2, 4)).needs == ((),)
    assert KeyLockPit().crop(rows=(2, 8), columns=(5, 8)).states.names == ("row", "column", "lock")
    room = KeyLockPit()
    mapping = project(room, room.crop(rows=(0, 8), columns=(0, 6)))
    assert mapping.coverage().mapped > 0


def test_starts():
    task = KeyLockPit("S.KL")
    assert task.mdp.start_states.size == 1
    # 4 cells without the key, 4 with it.
    assert task.with_start("uniform").mdp.start_states.size == 8
    held = KeyLockPit("S.KL", start="uniform", keys_held=True)
    assert (held.states.decode(held.mdp.start_states)["key"] == 1).all()
    cells = task.with_start([(0, 1), (0, 2)]).mdp
    assert task.states.decode(cells.start_states)["column"].tolist() == [1, 2]
    assert np.unique(cells.start[cells.start_states]).tolist() == [0.5]


REFUSED = {
    "nothing to do": (lambda: KeyLockPit("S.P"), "needs a key K or a lock L: there is none"),
    "no start": (lambda: KeyLockPit("KL"), "needs an S on the map"),
    "ended at the start": (lambda: KeyLockPit("SK", keys_held=True), r"not end it: got \(0, 0\)"),
    "all ended": (
        lambda: KeyLockPit("K", start="uniform", keys_held=True),
        "needs a state that does not end",
    ),
    "an unknown key": (lambda: KeyLockPit(needs=[[2]]), r"numbers from 1 to 1: got \[2\]"),
    "half a key": (lambda: KeyLockPit(needs=[[1.5]]), "keys of a lock must be whole numbers"),
    "too many keys": (lambda: KeyLockPit("S" + "K" * 30), "at most 5,000,000 states: 31 cells and"),
}
WRONG = {
    "map": [3, ["SK", "L"]],
    "needs": [[], "none"],
    "origin": [3],
}


@pytest.mark.parametrize(("error", "call", "says"), cases({TaskError: REFUSED}))
def test_what_makes_no_room_is_refused(error, call, says):
    check_refusal(error, call, says)


def test_wrong_values_are_named():
    check_values(TaskError, KeyLockPit, WRONG)
    starts = [[(0, 2)], [(0, 3)], [(0, 9)], "corner"]  # a pit, a wall, beyond
    check_values(TaskError, partial(KeyLockPit, "KLP#"), {"start": starts})
    check_values(TaskError, KeyLockPit.room, {"size": [3, 2000]})
