"""Designers: published ways to make a curriculum of candidates, and what they are compared with.

Each is a function of a problem, candidates for its sources, and a budget for its trainings.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
