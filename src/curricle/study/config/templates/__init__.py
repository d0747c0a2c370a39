"""Files to begin with: studies, and the design of a recipe."""

from importlib.resources import files

from curricle.errors import ConfigError
from curricle.study.config.tables import unknown

KINDS = ("maze", "pursuit", "gymnasium", "deep")
"""Of studies."""
DESIGN = "design"
"""The design of a recipe."""


def template(kind: str) -> str:
    """Return a commented file of one of the :data:`KINDS`, or of a design, that runs as it is."""
    known = (*KINDS, DESIGN)
    if kind not in known:
        raise ConfigError(f"template {kind!r} {unknown(kind, known)}")
    return files(__package__).joinpath(f"{kind}.toml").read_text(encoding="utf-8")
