"""Learning one task: potentials, exact planning, the learners and their compiled loops."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
