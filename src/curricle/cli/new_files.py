"""What ``curricle new`` writes: a file that is there, or a study of an environment."""

from curricle.cli.tables import line_width
from curricle.errors import ConfigError
from curricle.study.config.tables import suggestion
from curricle.study.config.templates import DESIGN, KINDS, template
from curricle.text_tables import text_table

__all__ = ["DESIGN", "kinds", "new_file"]
OTHERS = (
    "or the id of an environment of Gymnasium's registry: FrozenLake-v1, CartPole-v1, "
    "MiniGrid-DoorKey-5x5-v0"
)


def kinds() -> str:
    """Return what can be written, as text."""
    rows = [*KINDS.items(), ("ID", OTHERS)]
    return "\n".join(text_table(("curricle new", "writes"), rows, line_width(), words=True))


def new_file(kind: str) -> tuple[str, str]:
    """Return the name and the text of a file; ConfigError if nothing is called so."""
    if kind in KINDS:
        return f"{kind}.toml", template(kind)
    from curricle.study.config.templates.of_environment import environment_study

    if kind.isalpha() and kind.islower() and (meant := suggestion(kind, KINDS)):
        raise ConfigError(f"there is no study {kind!r} to start from{meant}")
    text = environment_study(kind)
    return f"{kind.rpartition(':')[2].replace('/', '-')}.toml", text
