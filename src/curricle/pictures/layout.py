"""Where the states of any task lie on a grid: as it says, or by its components and tables."""

import numpy as np

from curricle.arrays import IntArray
from curricle.tasks.layout import GridLayout
from curricle.tasks.mdp import generative_model, has_tables, tables

SIDES = (("row", "column"), ("row", "col"), ("y", "x"))
"""Components that say in which cell a state lies, by their names."""
MOST_STATES = 20_000_000  # states of a task whose cells are read off its components
MOST_STATES_OF_TABLES = 100_000  # states of a task whose ends are looked for in its tables


def layout_of(task: object) -> GridLayout | None:
    """Return where states lie, as a task says or by its row and column; None if it has neither."""
    layout = getattr(task, "layout", None)
    if isinstance(layout, GridLayout):
        return layout
    states = generative_model(task).states
    sides = next((names for names in SIDES if set(names) <= set(states.names)), None)
    if sides is None or states.size > MOST_STATES:
        return None
    values = states.decode()
    cells = np.stack([values[name] for name in sides], axis=1)
    origin, last = cells.min(axis=0), cells.max(axis=0)
    moving = dict[str, IntArray]()
    for up, across in SIDES:  # such as key_row and key_column; a key out of the grid is carried
        ends = f"_{up}", f"_{across}"
        for name in [name.removesuffix(ends[0]) for name in values if name.endswith(ends[0])]:
            if name + ends[1] in values:
                places = np.stack([values[name + end] for end in ends], axis=1)
                inside = ((places >= origin) & (places <= last)).all(axis=1, keepdims=True)
                moving[name] = np.where(inside, places, cells)
    rows, columns = (last - origin + 1).tolist()
    corner = int(origin[0]), int(origin[1])
    objects = _ends_of(task, cells)
    return GridLayout(cells, sides, (rows, columns), corner, objects, markers=moving)


Objects = tuple[tuple[str, int, int, bool], ...]


def _ends_of(task: object, cells: IntArray) -> Objects:
    """Return the cells of a task with tables that end every episode: goals, or pits that pay less.

    A goal pays the most of them, and no less than steps do as a rule.
    """
    if not has_tables(task) or generative_model(task).states.size > MOST_STATES_OF_TABLES:
        return ()
    mdp = tables(task)
    going = np.unique(cells[~mdp.terminal], axis=0).tolist()
    ends = [cell for cell in np.unique(cells[mdp.terminal], axis=0).tolist() if cell not in going]
    paid, happens = list[float](), mdp.probability > 0
    for cell in ends:
        into = happens & (cells == cell).all(axis=1)[mdp.next_state]
        paid.append(float(mdp.reward[into].max(initial=-np.inf)))
    least = max([*paid, float(np.median(mdp.reward[happens]))])
    reached = [(cell, pays) for cell, pays in zip(ends, paid, strict=True) if np.isfinite(pays)]
    return tuple(("goal" if pays >= least else "pit", *cell, True) for cell, pays in reached)
