"""Curricle: curriculum learning by potential-based reward shaping.

Train a reinforcement learner on easier source tasks, carry its values into a hard target
through mappings f(s, a), aggregate several sources into one potential, and shape or initialise
the target's learner with it.

Axis letters used throughout: S states, A actions, O outcomes of a pair, Y outcome rows, N sources
(transfers), K seeds, T checkpoints. Arrays of values and policies have axes (S, A).

The public names are those of ``__init__.pyi``; each is imported when first used, so that
``import curricle`` is quick. It registers ``Curricle/Maze-v0`` and ``Curricle/Pursuit-v0`` with
Gymnasium, and pictures of tasks with IPython.
"""

from pathlib import Path
from pkgutil import iter_modules
from re import findall

import lazy_loader

from curricle.interop import register
from curricle.show import notebook

__version__ = "0.3.0.dev0"

_attribute, __dir__, _offered = lazy_loader.attach_stub(__name__, __file__)
# Packages are attributes (`curricle.statistics`) and not exported.
_packages = {module.name for module in iter_modules(__path__)}
__all__ = [name for name in _offered if name not in _packages]


def __getattr__(name):
    if name not in _offered:
        said = f"curricle has no {name}{_meant(name)}"
        raise AttributeError(said, name=name, obj=None)  # without an object Python does not guess
    try:
        return _attribute(name)
    except AttributeError as error:  # `from curricle import` would take it for an unknown name
        raise ImportError(
            f"curricle.{name} cannot be imported: {error}; does a file beside the script have the "
            "name of a module that it hides?"
        ) from error


def _meant(name):
    """Return ``: did you mean NAME?`` for an unknown name, which may be in a package; or ""."""
    from difflib import get_close_matches

    folder, names = Path(__file__).parent, dict(zip(__all__, __all__, strict=True))
    stubs = [(file.parent.name, r" as (\w+)", file) for file in folder.glob("*/__init__.pyi")]
    for package, named, file in [*stubs, ("errors", r"class (\w+)", folder / "errors.py")]:
        for public in findall(named, file.read_text("utf-8")):
            names.setdefault(public, f"{package}.{public}")
    if name in names:
        return f": did you mean {names[name]}?"
    lower = {public.lower(): public for public in reversed(names)}
    word = name.lower().replace("ucb", "optimistic")
    near = get_close_matches(word, lower, 1) if name[:1] != "_" else []
    return "".join(f": did you mean {names[lower[public]]}?" for public in near)


register()
notebook.register()
