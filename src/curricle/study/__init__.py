"""Studies: arms x seeds, the measures taken from their curves, and what they say.

``metrics`` reads learning curves (``curve`` and ``threshold`` are its rooms next door) and
``statistics`` puts intervals on what it finds; they hold arrays only and know nothing of tasks or
learners.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
