"""Studies to begin with."""

from importlib.resources import files

from curricle.errors import ConfigError
from curricle.study.schema import unknown

KINDS = {
    "maze": "a maze learnt from its corner",
    "pursuit": "two predators learn to hunt from the values of one",
    "gymnasium": "a slippery lake learnt from one that is not",
    "deep": "a network learns three walls from solved levels of one wall",
}
"""Files that are there, and what they are about."""


def template(kind: str) -> str:
    """Return a commented file of one of the :data:`KINDS` that runs as it is."""
    if kind not in KINDS:
        raise ConfigError(f"template {kind!r} {unknown(kind, KINDS)}")
    return files(__package__).joinpath(f"{kind}.toml").read_text(encoding="utf-8")
