"""Studies: files that describe them, runs that survive interruption, and their results.

``config`` reads a study file; ``running`` trains the units of its ``arms`` and stores their
results in a ``store``; ``results`` reads these.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
