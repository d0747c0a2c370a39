"""Names of states and actions, to be used in sentences."""

from curricle.tasks.spaces import Space


def state_name(space: Space, state: int) -> str:
    """Return a state's number and its components in words.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> state_name(GridWorld(["S.", ".T"]).states, 2)
    'state 2 (row 1, column 0)'
    """
    parts = _parts(space, state)
    if len(parts) == 1 and parts[0][1] == str(state):
        return f"state {state}"
    return f"state {state} ({', '.join(f'{name} {label}' for name, label in parts)})"


def action_name(space: Space, action: int) -> str:
    """Return an action in words.

    Examples
    --------
    >>> from curricle import GridWorld, Pursuit
    >>> action_name(GridWorld("S.T").actions, 1), action_name(Pursuit(2, 2).actions, 1)
    ('east', 'predator_1 stay, predator_2 north')
    """
    parts = _parts(space, action)
    if len(parts) > 1:
        return ", ".join(f"{name} {label}" for name, label in parts)
    labelled = space.components[0].labels is not None
    return parts[0][1] if labelled else f"{parts[0][0]} {parts[0][1]}"


def values_of(space: Space, point: int) -> dict[str, int]:
    """Return a point's components by name.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> values_of(GridWorld(["S.", ".T"]).states, 2)
    {'row': 1, 'column': 0}
    """
    return {name: int(value) for name, value in space.decode(point).items()}


def _parts(space: Space, point: int) -> list[tuple[str, str]]:
    values = values_of(space, point)
    return [(c.name, c.label(values[c.name])) for c in space.components]
