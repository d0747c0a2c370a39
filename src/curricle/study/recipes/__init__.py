"""Recipes as TOML files: how one is designed, what was found, and the study of one member.

``design_file`` reads the family and the members that a recipe is designed on; ``recipe_file``
stores a recipe; ``from_recipe`` writes it as an ordinary study of one member.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
