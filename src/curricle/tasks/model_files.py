"""Files of explicit models as other programs write them: Cassandra's, Storm's and PRISM's."""

import re
from collections.abc import Callable, Iterator, Sequence
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from curricle.arrays import FloatArray
from curricle.checks import brief, check_memory, one_of
from curricle.errors import TaskError
from curricle.files import read_bounded
from curricle.tasks.mdp import FiniteMDP
from curricle.tasks.spaces import Component, Space

INITIAL = "init"  # the label of states that episodes start in
LARGEST = 2**30  # bytes of a file, at most
OF_STATE = 1_000  # bytes that a state takes while it is read, about


class Choice(NamedTuple):
    """A state, what can be done there, and where that leads."""

    state: int
    action: str  # its name, "" if it has none
    outcomes: dict[int, float]  # next state -> probability
    rewards: dict[int, float]  # next state -> reward


class Model(NamedTuple):
    """What a file says."""

    n_states: int
    choices: list[Choice]
    labels: dict[str, set[int]]
    start: FloatArray | None = None
    discount: float | None = None
    names: tuple[str, ...] | None = None  # of the states


def read_model(
    path: str | Path,
    *,
    discount: float | None = None,
    terminal: Sequence[str] = (),
    reward: str | None = None,
    time_limit: int | None = None,
) -> FiniteMDP:
    """Return the task of a file, by the end of its name.

    - ``.mdp`` or ``.pomdp``, Cassandra's format: a POMDP as if its states were seen. Rewards that
      depend on the observation are averaged over the observations.
    - ``.drn``, Storm's format, of an MDP, a Markov chain or a POMDP as if its states were seen.
    - ``.tra``, PRISM's or Storm's transitions; what lies beside it under the same name counts too:
      ``.trew`` and ``.srew``, the rewards of transitions and states, and ``.lab``, the labels.

    Episodes end in states that are never left and pay nothing.

    Parameters
    ----------
    path : str or Path
    discount : float, optional
        Needed where the file states none; only Cassandra's does.
    terminal : sequence of str
        Further states that end episodes, by their labels.
    reward : str, optional
        The reward model, of a ``.drn`` that has several.
    time_limit : int, optional

    Returns
    -------
    FiniteMDP
        Its actions have the names in the file where each state's are unique, else numbers.

    Raises
    ------
    TaskError
        When a line cannot be read, a name is unknown, or no discount is known.
    OSError
        When the file cannot be opened.

    Examples
    --------
    >>> from pathlib import Path
    >>> from tempfile import mkdtemp
    >>> file = Path(mkdtemp()) / "coin.drn"
    >>> _ = file.write_text('''@type: MDP
    ... @reward_models
    ... win
    ... @model
    ... state 0 [0] init
    ...   action flip [1]
    ...     0 : 0.5
    ...     1 : 0.5
    ... state 1 [0]
    ...   action stay [0]
    ...     1 : 1
    ... ''')
    >>> task = read_model(file, discount=0.9)
    >>> task.terminal.tolist(), task.actions.label(0)
    ([False, True], 'action=flip')
    """
    path = Path(path)
    one_of("the end of a model's name", path.suffix, READERS, TaskError)
    model = READERS[path.suffix](path, reward)
    discount = model.discount if discount is None else discount
    if discount is None:
        raise TaskError(f"a task needs a discount: {path.name} states none; pass discount=")
    names, actions = _actions(model.choices)
    n_states = model.n_states
    left = np.zeros(n_states, np.bool_)
    for state, _, outcomes, rewards in model.choices:
        stays = outcomes.get(state, 0.0) == 1.0 and not any(rewards.values())
        left[state] |= not stays
    for label in terminal:
        one_of(f"a label of {path.name}", label, model.labels, TaskError)
        left[[*model.labels[label]]] = False
    start = model.start
    if start is None:
        first = sorted(model.labels.get(INITIAL, {0}))
        start = np.isin(np.arange(n_states), first) / len(first)
    p = _matrix([choice.outcomes for choice in model.choices], n_states)
    r = _matrix([choice.rewards for choice in model.choices], n_states)
    return FiniteMDP.from_pairs(
        p, r, [choice.state for choice in model.choices], actions, start=start, terminal=~left,
        discount=discount, time_limit=time_limit,
        states=Space([Component("state", n_states, labels=model.names)]),
        actions=Space([Component("action", len(names), labels=names if any(names) else None)]),
    )  # fmt: skip


def _matrix(rows: Sequence[dict[int, float]], width: int) -> Any:
    """Return rows by column as a sparse matrix."""
    from scipy.sparse import csr_array

    columns = [column for row in rows for column in row]
    numbers = [value for row in rows for value in row.values()]
    ends = np.cumsum([0, *map(len, rows)])
    return csr_array((numbers, columns, ends), shape=(len(rows), width))


def _actions(choices: Sequence[Choice]) -> tuple[tuple[str, ...], list[int]]:
    """Return the names of all actions, and each choice's action."""
    names = tuple(dict.fromkeys(choice.action for choice in choices))
    pairs = {(choice.state, choice.action) for choice in choices}
    if len(pairs) == len(choices) and all(names) and not all(map(str.isdigit, names)):
        return names, [names.index(choice.action) for choice in choices]
    of_state: dict[int, int] = {}
    numbers = []
    for choice in choices:
        numbers.append(of_state.setdefault(choice.state, 0))
        of_state[choice.state] += 1
    return ("",) * (1 + max(numbers, default=0)), numbers


def _text(path: Path) -> str:
    """Return a file's text; TaskError if it is none."""
    try:
        return read_bounded(path, LARGEST).decode()
    except UnicodeDecodeError:
        raise TaskError(f"a model must be a text, in UTF-8: {path.name} is none") from None


def _lines(path: Path) -> Iterator[tuple[str, str]]:
    """Yield the lines that are not empty, with their places."""
    for n, line in enumerate(_text(path).splitlines(), start=1):
        if line.strip():
            yield line.strip(), f"{path.name}, line {n}"


def _read(word: str, kind: type, place: str) -> Any:
    try:
        return kind(word)
    except ValueError:
        raise TaskError(f"{place}: this must be a number: {word!r}") from None


# -- Storm and PRISM -------------------------------------------------------------------------------

STATE = re.compile(r"state (\d{1,18})(?: ![^ ]+)?(?: \{[^}]*\})?(?: \[([^\]]*)\])?(.*)")
ACTION = re.compile(r"action (\S+)(?: \[([^\]]*)\])?")


def _drn(path: Path, wanted: str | None) -> Model:
    """Return what a file of Storm's says; states and actions have rewards, which add up."""
    models, which, section = list[str](), 0, ""
    choices, labels = list[Choice](), dict[str, set[int]]()
    state, states, paid, earned = 0, 0, 0.0, 0.0
    for line, place in _lines(path):
        if line.startswith("@"):
            section, _, value = line[1:].partition(":")
            if section == "type":
                one_of(f"{path.name}: the type", value.strip(), ("MDP", "DTMC", "POMDP"), TaskError)
            if section == "model" and models:
                if wanted is None and len(models) > 1:
                    raise TaskError(f"{path.name} has several rewards: name one of {models}")
                one_of(f"a reward of {path.name}", wanted or models[0], models, TaskError)
                which = models.index(wanted or models[0])
        elif section == "reward_models":
            models += line.split()
        elif found := STATE.fullmatch(line):
            state, states, paid = int(found[1]), states + 1, _reward(found[2], which, place)
            for label in found[3].split():
                labels.setdefault(label, set()).add(state)
        elif found := ACTION.fullmatch(line):
            earned = paid + _reward(found[2], which, place)
            choices.append(Choice(state, found[1], {}, {}))
        elif section == "model" and line.count(":") == 1 and choices:
            after, chance = (word.strip() for word in line.split(":"))
            after = _read(after, int, place)
            choices[-1].outcomes[after] = _read(chance, float, place)
            choices[-1].rewards[after] = earned
        elif section == "model" and not line.startswith("//"):
            raise TaskError(f"{place}: a state, an action or an outcome must stand here: {line!r}")
    return _checked(path, Model(states, choices, labels))


def _reward(listed: str | None, which: int, place: str) -> float:
    """Return one of the rewards in brackets, 0 where there are none."""
    words = (listed or "").split(",")
    return float(_read(words[which], float, place)) if listed and which < len(words) else 0.0


def _tra(path: Path, _wanted: str | None) -> Model:
    """Return what transitions and the files beside them say."""
    choices, labels = dict[tuple[int, int], Choice](), dict[str, set[int]]()
    states, names = 0, dict[str, str]()
    for words, place in _rows(path, 4):
        state, choice, after = (_read(word, int, place) for word in words[:3])
        made = Choice(state, words[4] if len(words) > 4 else "", {}, {})
        made = choices.setdefault((state, choice), made)
        made.outcomes[after] = _read(words[3], float, place)
        states = max(states, state + 1, after + 1)
    for words, place in _rows(path.with_suffix(".trew"), 4):
        state, choice, after = (_read(word, int, place) for word in words[:3])
        if (state, choice) not in choices:
            raise TaskError(f"{place}: {path.name} has no choice {choice} in state {state}")
        choices[state, choice].rewards[after] = _read(words[3], float, place)
    paid = {
        _read(words[0], int, place): _read(words[1], float, place)
        for words, place in _rows(path.with_suffix(".srew"), 2, most=2)
    }
    for (state, _), made in choices.items() if paid else ():
        for after in made.outcomes:
            made.rewards[after] = made.rewards.get(after, 0.0) + paid.get(state, 0.0)
    beside = path.with_suffix(".lab")
    for line, place in _lines(beside) if beside.exists() else ():
        if not names:  # 0="init" 1="goal"
            names = dict(re.findall(r'(\d+)="([^"]*)"', line))
            continue
        state, _, numbers = line.partition(":")
        for n in numbers.split():
            labels.setdefault(names.get(n, n), set()).add(_read(state, int, place))
    return _checked(path, Model(states, list(choices.values()), labels))


def _rows(path: Path, least: int, most: int = 5) -> Iterator[tuple[list[str], str]]:
    """Yield the rows of a file, of so many words each, without its head; none if it is missing."""
    for n, (line, place) in enumerate(_lines(path) if path.exists() else ()):
        words = line.split()
        if n == 0 and (len(words) < least or most == least):
            continue
        if not least <= len(words) <= most:
            raise TaskError(f"{place}: a row must have {least} to {most} words: got {line!r}")
        yield words, place


def _checked(path: Path, model: Model) -> Model:
    """Return a model whose states are all there, each with a choice."""
    if not model.choices:
        raise TaskError(f"{path.name} must have rows of states and choices: got none")
    n_states, with_choice = model.n_states, {choice.state for choice in model.choices}
    check_memory(f"the states of {path.name}", OF_STATE * n_states, TaskError)
    named = [(choice.state, *choice.outcomes, *choice.rewards) for choice in model.choices]
    for state in chain(*named, *model.labels.values()):
        if not 0 <= state < n_states:
            raise TaskError(f"{path.name}: states must lie in 0..{n_states - 1}: got {state}")
    for state in {*range(n_states)} - with_choice:  # without a choice nothing happens there
        model.choices.append(Choice(state, "", {state: 1.0}, {}))
    return model


# -- Cassandra's format ----------------------------------------------------------------------------

STATEMENT = re.compile(
    r"^[ \t]*(discount|values|states|actions|observations|start|start[ \t]+include"
    r"|start[ \t]+exclude|T|O|R)[ \t]*:",
    re.MULTILINE,
)


class Axis(NamedTuple):
    """The states, actions or observations of a file."""

    kind: str
    names: Sequence[str]

    def place(self, word: str, file: str) -> Any:
        """Return where a name or a number stands; ``*`` stands for all."""
        if word == "*":
            return slice(None)
        if word in self.names:
            return self.names.index(word)
        if not word.isdigit() or int(word) >= len(self.names):
            raise TaskError(f"{file}: one of its {len(self.names)} {self.kind} is needed: {word!r}")
        return int(word)


def _cassandra(path: Path, _wanted: str | None) -> Model:
    """Return what a file of Cassandra's says; of statements on the same, the last counts."""
    file, text = path.name, re.sub("#.*", "", _text(path))
    _, *parts = STATEMENT.split(text)
    statements = [(kind.split(), body) for kind, body in zip(parts[::2], parts[1::2], strict=True)]
    said = {kind[-1]: body.split() for kind, body in statements}
    axes = []
    for kind in ("actions", "states", "observations"):
        words = said.get(kind) or ["1"] * (kind == "observations")
        if not words:
            raise TaskError(f"{file} must list its {kind}, or say how many there are")
        if len(words) == 1 and words[0].isdecimal():
            count = _read(words[0], int, file)
            check_memory(f"the {kind} of {file}", OF_STATE * count, TaskError)
            words = [*map(str, range(count))]
        axes.append(Axis(kind, words))
    a, s, o = axes
    sizes = {"T": (a, s, s), "O": (a, s, o), "R": (a, s, s, o)}
    cells = len(a.names) * len(s.names) * (len(s.names) + 1) * (1 + len(o.names))
    check_memory(f"the tables of {file}", 8 * cells, TaskError)
    tables = {kind: np.zeros([len(axis.names) for axis in of]) for kind, of in sizes.items()}
    start = _start(said, s, file)
    for (kind, *_), body in statements:
        if kind in tables:
            _fill(tables[kind], sizes[kind], body, start, f"{file}, {kind}:{brief(body)}")
    seen = tables["O"] if "O" in said else np.ones(tables["O"].shape)
    sign = -1.0 if said.get("values") == ["cost"] else 1.0
    paid = sign * np.einsum("asto,ato->ast", tables["R"], seen)
    choices = []
    for state, action in np.ndindex(len(s.names), len(a.names)):
        after = np.flatnonzero(tables["T"][action, state]).tolist()
        outcomes, rewards = (
            dict(zip(after, table[action, state, after].tolist(), strict=True))
            for table in (tables["T"], paid)
        )
        choices.append(Choice(state, a.names[action], outcomes, rewards))
    named = s.names != [*map(str, range(len(s.names)))]
    discount = _read(said["discount"][0], float, file) if said.get("discount") else None
    labels = {name: {n} for n, name in enumerate(s.names)}
    names = tuple(s.names) if named else None
    return Model(len(s.names), choices, labels, start, discount, names)


def _start(said: dict[str, list[str]], states: Axis, file: str) -> FloatArray:
    """Return the start distribution, (S,); by default all states are equally likely."""
    n_states, words = len(states.names), said.get("start", ["uniform"])
    start = np.zeros(n_states)
    if "include" in said or "exclude" in said:
        listed = said.get("include") or said["exclude"]
        start[[states.place(word, file) for word in listed]] = 1.0
        start = start if "include" in said else 1.0 - start
    elif words == ["uniform"]:
        start[:] = 1.0
    elif len(words) == 1 != n_states:
        start[states.place(words[0], file)] = 1.0
    elif len(words) == n_states:
        start[:] = [_read(word, float, file) for word in words]
    else:
        raise TaskError(f"{file}: start must name a state or give {n_states} probabilities")
    return np.asarray(start / start.sum())


def _fill(
    table: FloatArray, axes: Sequence[Axis], body: str, start: FloatArray, place: str
) -> None:
    """Write what a statement says into the part of a table that its names stand for."""
    *first, last = body.split(":")
    name, *words = last.split() or [""]
    names = [*map(str.strip, first), name]
    where = tuple(axis.place(word, place) for axis, word in zip(axes, names, strict=False))
    shape = table.shape[len(names) :]
    values: FloatArray
    if words == ["uniform"]:
        values = np.full(shape, 1 / shape[-1])
    elif words == ["identity"]:
        values = np.eye(*shape)
    elif words == ["reset"]:
        values = start
    else:
        values = np.array([_read(word, float, place) for word in words])
        if values.size != int(np.prod(shape)):
            raise TaskError(f"{place}: {int(np.prod(shape))} numbers are needed: got {len(words)}")
        values = values.reshape(shape)
    table[where] = values


READERS: dict[str, Callable[[Path, str | None], Model]] = {
    ".mdp": _cassandra,
    ".pomdp": _cassandra,
    ".drn": _drn,
    ".tra": _tra,
}
