"""All drawing: figures, mazes and potentials, and a study's report as an HTML page.

``views`` defines cells and markers that move over them, ``style`` colours and numbers as text. From
both come Matplotlib's figures, SVG on a page, pixels, and text in a terminal.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
