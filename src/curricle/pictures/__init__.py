"""Pictures of a task: where its states lie on a grid, what moves over it, and its episodes."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
