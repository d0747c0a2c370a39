from .grids import (
    draw_maze as draw_maze,
    draw_potential as draw_potential,
    draw_sources as draw_sources,
    frame_cells as frame_cells,
)
from .learning_curves import draw_curve as draw_curve
from .picture import content_of as content_of, plot as plot, save as save
from .styles import COLOURS as COLOURS, STYLE as STYLE, new_figure as new_figure
