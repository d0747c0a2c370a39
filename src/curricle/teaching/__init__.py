"""Teachers within a run: which of several tasks of one space the next episode is drawn from."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
