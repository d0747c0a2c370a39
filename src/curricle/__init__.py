"""Curricle: curriculum learning by potential-based reward shaping.

Train a reinforcement learner on easier source tasks, carry its values into a hard target
through mappings f(s, a), aggregate several sources into one potential, and shape or initialise
the target's learner with it.

Axis letters used throughout: S states, A actions, O outcomes of a pair, Y outcome rows, N sources
(transfers), K seeds, T checkpoints. Arrays of values and policies have axes (S, A).

The public names are those of ``__init__.pyi``; each is imported when first used, so that
``import curricle`` is quick. It registers ``Curricle/Maze-v0`` and ``Curricle/Pursuit-v0`` with
Gymnasium.
"""

from pkgutil import iter_modules

import lazy_loader

from curricle.interop import register

__version__ = "0.3.0.dev0"

__getattr__, __dir__, _offered = lazy_loader.attach_stub(__name__, __file__)
# Packages are attributes (`curricle.statistics`) and not exported.
_packages = {module.name for module in iter_modules(__path__)}
__all__ = [name for name in _offered if name not in _packages]

register()
