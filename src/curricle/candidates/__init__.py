"""Candidates for the sources of a target: easier relatives, made from the target itself."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
