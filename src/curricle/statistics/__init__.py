"""Learning curves, metrics on them, intervals over seeds and hypothesis tests.

All of it works on arrays. Axes: K seeds, T checkpoints, M tasks, L thresholds.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
