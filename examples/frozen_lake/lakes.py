"""Which cell of the 4x4 lake lies where a cell of the 8x8 lake lies."""


def halved(state, action):
    ((name, cell),) = state.items()
    row, column = divmod(cell, 8)
    return {name: row // 2 * 4 + column // 2}, action
