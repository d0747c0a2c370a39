"""Everything that is drawn: figures, mazes and potentials, a study's report as one HTML page.

What moves and what a cell is (``views``), the colours and the words of numbers (``style``) are said
once; Matplotlib's figures, SVG on a page, pixels and text in a terminal are outputs of them.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
