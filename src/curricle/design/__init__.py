"""Designing curricula: candidates for the sources of a target, and what a design costs."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
