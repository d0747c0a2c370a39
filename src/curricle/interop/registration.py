"""Curricle's own domains in Gymnasium's registry."""


def register() -> None:
    """Register ``Curricle/Maze-v0`` and the others; Gymnasium calls this when it is imported."""
