"""Results drawn: figures, mazes and potentials, and a study's report as an HTML page.

``style`` has colours and numbers as text, for Matplotlib's figures and for SVG on a page.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
