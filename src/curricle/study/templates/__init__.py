"""Templates of studies: commented files, and a file for any environment."""

import tomllib
from collections.abc import Callable
from contextlib import suppress
from importlib import import_module
from importlib.resources import files
from importlib.util import find_spec
from pathlib import Path

KINDS = {
    "maze": "a maze learnt from its corner",
    "pursuit": "two predators learn to hunt from the values of one",
    "gymnasium": "a slippery lake learnt from one that is not",
    "deep": "a network learns three walls from solved levels of one wall",
    "stages": "a network fetches a key and opens a door in ever larger rooms",
}
"""Name of a ready file, which runs unchanged -> its subject."""


def new_study(
    kind: str, folder: Path = Path(), say: Callable[[str], object] = lambda _: None
) -> tuple[str, str, list[str]]:
    """Return the name and text of a study file, and sentences on its environment.

    The command ``curricle new`` writes the text into the folder.

    Parameters
    ----------
    kind : str
        A ready file, an id of Gymnasium's registry, or a class or function of one's own as
        ``module:Class``, whose module is looked for in the folder.
    folder : Path
        Where the file is to lie; the working directory by default.
    say : callable
        Called with each step, and the longest that it may take.

    Raises
    ------
    ConfigError
        When nothing is called so, or the environment cannot be played, with its file and line.

    Examples
    --------
    >>> file, text, _ = new_study("maze")
    >>> file, text.splitlines()[0]
    ('maze.toml', '# A maze learnt from its corner. Run it with: curricle run FILE')
    """
    if kind in KINDS:
        return file_name(kind), template(kind), []
    # Imported here, as a ready file and the command's help need no more of the library.
    from curricle.errors import ConfigError
    from curricle.study.arms import Arms
    from curricle.study.config import configured
    from curricle.study.templates.environment import environment_study
    from curricle.study_file.file import Positions
    from curricle.study_file.own_code import load, suggestion

    if kind.isalpha() and kind.islower() and (meant := suggestion(kind, KINDS)):
        raise ConfigError(f"there is no study {kind!r} to start from{meant}")
    _, colon, last = kind.rpartition(":")
    is_code = bool(colon) and last.isidentifier()
    name = kind if is_code else _known(kind)
    text, notes = environment_study(name, load(name, folder) if is_code else name, say)
    say("building the study, as curricle check does (at most as long as its states took)")
    file = file_name(kind)
    Arms.of(configured(tomllib.loads(text), folder, Positions(file, text)))
    return file, text, notes


def file_name(kind: str) -> str:
    """Return the name of the file of a kind, of an id or of ``module:Class``."""
    return f"{kind.rpartition(':')[2].replace('/', '-')}.toml"


def template(kind: str) -> str:
    """Return a commented file of one of the :data:`KINDS`."""
    return files(__package__).joinpath(f"{kind}.toml").read_text(encoding="utf-8")


def _importable(module: str) -> bool:
    """Return whether a module, maybe one in a package, can be imported."""
    with suppress(ImportError, ValueError):  # where its package is not there, or no name at all
        return find_spec(module) is not None
    return False


def _known(name: str) -> str:
    """Return the id of an environment (MiniGrid's with its module); ConfigError if unknown."""
    from gymnasium.envs.registration import registry

    from curricle.errors import ConfigError
    from curricle.interop.gymnasium import suggested_ids

    module, colon, _ = name.partition(":")
    if name in registry or (colon and _importable(module)):
        return name  # gymnasium.make imports the module, which registers its environments
    if find_spec("minigrid"):
        import_module("minigrid")
    if name in registry:
        return f"minigrid:{name}"  # with its module, other processes find it
    raise ConfigError(
        f"no environment of Gymnasium's registry is called {name!r}{suggested_ids(name)}; curricle "
        "new without a name lists what else there is"
    )
