"""Certificates: whether a shaping keeps the optimal policies, proven, refuted or open."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
