"""Recipes as TOML files.

``design_file`` reads the family and the members that a recipe is designed on, and ``designing``
designs it; ``recipe_file`` stores and reads it; ``from_recipe`` writes it as an ordinary study of
one member.
"""
