"""Study files to begin with."""

from importlib.resources import files

from curricle.errors import ConfigError
from curricle.study.config.tables import unknown

KINDS = ("maze", "pursuit", "gymnasium", "deep")


def template(kind: str) -> str:
    """Return a commented study file of one of the :data:`KINDS` that runs as it is."""
    if kind not in KINDS:
        raise ConfigError(f"template {kind!r} {unknown(kind, KINDS)}")
    return files(__package__).joinpath(f"{kind}.toml").read_text(encoding="utf-8")
