"""Files of models as Cassandra's program, Storm and PRISM write them."""

import numpy as np
import pytest

import curricle as cr
from curricle.errors import TaskError
from curricle.tasks import read_model
from tests.support.refusals import check_refusal
from tests.support.tasks import random_mdp

TIGER = """
# Cassandra, Kaelbling, Littman 1994
discount: 0.95
values: reward
states: tiger-left tiger-right
actions: listen open-left open-right
observations: left right
start: uniform
T: listen
identity
T:open-left
uniform
T:open-right
uniform
O:listen
0.85 0.15
0.15 0.85
O:open-left
uniform
O:open-right
uniform
R:listen : * : * : * -1
R:open-left : tiger-left : * : * -100
R:open-left : tiger-right : * : * 10
R:open-right : tiger-left : * : * 10
R:open-right : tiger-right : * : * -100
"""
TRA = "3 4 5\n0 0 0 0.1 go\n0 0 1 0.9 go\n0 1 0 1 stay\n1 0 2 1 go\n2 0 2 1 stay"
DRN = """
// Exported by storm
@type: MDP
@parameters

@reward_models
coins steps
@nr_states
3
@nr_choices
4
@model
state 0 [0, 1] init
\taction go [2, 0]
\t\t0 : 0.1
\t\t1 : 0.9
\taction stay [0, 0]
\t\t0 : 1
state 1 [0, 1] deep
\taction go [5, 0]
\t\t2 : 1
state 2 [0, 0] goal
\taction stay [0, 0]
\t\t2 : 1
"""


@pytest.fixture
def written(tmp_path):
    """Write a file, and return its path."""

    def write(name, text):
        (tmp_path / name).write_text(text)
        return tmp_path / name

    return write


def listed(mdp):
    """Yield each pair of a state that does not end, with p(s' | s, a) and the rewards."""
    for state in np.flatnonzero(~mdp.terminal):
        for action in range(mdp.actions.size):
            row, p, r = mdp.outcome_row[state, action], *np.zeros((2, mdp.states.size))
            np.add.at(p, mdp.next_state[row], mdp.probability[row])
            np.add.at(r, mdp.next_state[row], mdp.probability[row] * mdp.reward[row])
            yield state, action, p, np.divide(r, p, out=np.zeros(len(p)), where=p > 0)


def as_cassandra(mdp):
    lines = [f"discount: {mdp.discount}", "values: cost", f"states: {mdp.states.size}"]
    lines += [f"actions: {mdp.actions.size}", f"start: {' '.join(map(str, mdp.start))}"]
    lines += [f"T: * : {state} : {state} 1" for state in np.flatnonzero(mdp.terminal)]
    for state, action, p, r in listed(mdp):
        lines.append(f"T: {action} : {state}\n{' '.join(map(repr, p.tolist()))}")
        lines += [f"R: {action} : {state} : {n} {-r[n]!r}" for n in np.flatnonzero(p)]
    return "\n".join(lines).replace("np.float64(", "").replace(")", "")


def as_prism(mdp):
    """Return .tra, .trew and .lab."""
    tra, trew = ["head"], ["head"]
    for state, action, p, r in listed(mdp):
        for n in np.flatnonzero(p).tolist():
            tra.append(f"{state} {action} {n} {float(p[n])!r}")
            trew.append(f"{state} {action} {n} {float(r[n])!r}")
    tra += [f"{state} 0 {state} 1.0" for state in np.flatnonzero(mdp.terminal)]
    first = "\n".join(f"{state}: 0" for state in mdp.start_states)
    return "\n".join(tra), "\n".join(trew), f'0="init"\n{first}'


@pytest.mark.parametrize("seed", range(4))
def test_a_task_that_is_written_is_read(seed, written):
    mdp = random_mdp(seed, discount=0.9)
    tra, trew, lab = as_prism(mdp)
    written("m.trew", trew), written("m.lab", lab)
    read = [read_model(written("m.mdp", as_cassandra(mdp)))]
    read.append(read_model(written("m.tra", tra), discount=0.9))
    expected = list(listed(mdp))
    for task in read:
        np.testing.assert_array_equal(task.terminal, mdp.terminal)
        for (*pair, p, r), (*other, q, s) in zip(listed(task), expected, strict=True):
            assert pair == other
            np.testing.assert_allclose(p, q, atol=1e-12)
            np.testing.assert_allclose(r, s, atol=1e-12)
    assert cr.solve(read[0]).start_value == pytest.approx(cr.solve(mdp).start_value)


def test_a_pomdp_is_read_as_if_its_states_were_seen(written):
    tiger = read_model(written("tiger.pomdp", TIGER))
    assert tiger.states.component("state").labels == ("tiger-left", "tiger-right")
    values = cr.solve(tiger).action_values
    np.testing.assert_allclose(values[0], [0.95 * 200 - 1, 0.95 * 200 - 100, 200.0])


def test_rewards_of_observations_are_averaged(written):
    seen = TIGER.replace("R:listen : * : * : * -1", "R:listen : tiger-left : * \n 1 3")
    tiger = read_model(written("tiger.pomdp", seen), discount=0.5)
    row = tiger.outcome_row[0, 0]
    assert tiger.reward[row][tiger.probability[row] > 0] == pytest.approx([0.85 * 1 + 0.15 * 3])
    assert tiger.discount == 0.5


def test_starts_of_cassandra(written):
    for said, start in (
        ("start: tiger-right", [0, 1]),
        ("start: 1", [0, 1]),
        ("start: 0.25 0.75", [0.25, 0.75]),
        ("start include: tiger-left", [1, 0]),
        ("start exclude: 0", [0, 1]),
        ("", [0.5, 0.5]),
    ):
        task = read_model(written("tiger.pomdp", TIGER.replace("start: uniform", said)))
        assert task.start.tolist() == start


def test_prism_and_storm_say_the_same(written):
    written("errand.trew", "3 4 2\n0 0 1 2\n0 0 0 2\n1 0 2 5")
    written("errand.lab", '0="init" 1="goal"\n0: 0\n2: 1')
    prism = read_model(written("errand.tra", TRA), discount=0.9)
    storm = read_model(written("errand.drn", DRN), discount=0.9, reward="coins")
    for task in (prism, storm):
        assert task.terminal.tolist() == [False, False, True]
        assert task.actions.component("action").labels == ("go", "stay")
        assert task.available.tolist() == [[True, True], [True, False], [True, True]]
    assert cr.solve(prism).start_value == cr.solve(storm).start_value
    written("errand.srew", "3 2\n0 1\n1 1")
    (written("errand.trew", "")).unlink()
    steps = read_model(written("errand.tra", TRA), discount=0.9)
    storm = read_model(written("errand.drn", DRN), discount=0.9, reward="steps", terminal=["deep"])
    assert storm.terminal.tolist() == [False, True, True]
    assert cr.solve(steps).start_value == pytest.approx(1 / (1 - 0.9))  # to stay is best


@pytest.mark.parametrize(
    ("name", "text", "settings", "message"),
    [
        ("m.txt", "", {}, "the end of a model's name must be one of"),
        ("m.tra", TRA, {}, "m.tra states none; pass discount="),
        ("m.tra", "0 0 1", {}, "must have rows of states and choices: got none"),
        ("m.tra", TRA + "\n1 2", {}, "m.tra, line 7: a row must have 4 to 5 words"),
        ("m.tra", TRA.replace("0.9", "most"), {}, "line 3: this must be a number: 'most'"),
        ("m.drn", DRN, {}, "has several rewards: name one of"),
        ("m.drn", DRN, {"reward": "gold"}, "a reward of m.drn must be one of"),
        ("m.drn", DRN, {"reward": "coins", "terminal": ["end"]}, "a label of m.drn must be one of"),
        ("m.drn", DRN.replace("1 : 0.9", "7 : 0.9"), {"reward": "coins"}, "lie in 0..2: got 7"),
        ("m.drn", DRN.replace("MDP", "MA"), {"reward": "coins"}, "m.drn: the type must be one of"),
        ("m.drn", DRN.replace("2 : 1", "somewhere"), {"reward": "coins"}, "line 21: a state, an"),
        ("m.tra", TRA + "\n0 1 99999999999 1 far", {}, "the states of m.tra must fit half"),
        ("m.tra", TRA + "\n0 1 -1 1 back", {}, "lie in 0..2: got -1"),
        (
            "m.mdp",
            TIGER.replace("tiger-left tiger-right\nactions", "9" * 12 + "\nactions"),
            {},
            "the states of m.mdp must fit half",
        ),
        ("m.mdp", "discount: 0.9", {}, "must list its actions"),
        ("m.mdp", TIGER.replace("T:open-left", "T:open"), {}, "one of its 3 actions is needed"),
        ("m.mdp", TIGER.replace("0.85 0.15\n", "0.85\n"), {}, "4 numbers are needed: got 3"),
        ("m.mdp", TIGER.replace("start: uniform", "start: 1 2 3"), {}, "give 2 probabilities"),
        ("m.mdp", TIGER.replace("* -1\n", "* one\n"), {}, "this must be a number: 'one'"),
    ],
)
def test_refusals(name, text, settings, message, written):
    settings = {"discount": None if "pass discount" in message else 0.9} | settings
    check_refusal(TaskError, lambda: read_model(written(name, text), **settings), message)


def test_what_is_no_text_is_refused(tmp_path):
    file = tmp_path / "m.drn"
    file.write_bytes(b"\xff\xfe\x00state 0")
    check_refusal(TaskError, lambda: read_model(file, discount=0.9), "m.drn is none")


def test_labels_of_states_that_are_not_there_are_refused(written):
    written("m.lab", '0="goal"\n7: 0')
    check_refusal(TaskError, lambda: read_model(written("m.tra", TRA), discount=0.9), "got 7")
