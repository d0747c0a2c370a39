from .forecast import draw_forecast as draw_forecast
from .grids import (
    draw_maze as draw_maze,
    draw_potential as draw_potential,
    draw_sources as draw_sources,
    frame_cells as frame_cells,
)
from .learning_curves import (
    draw_comparison as draw_comparison,
    draw_curve as draw_curve,
    draw_learning_curves as draw_learning_curves,
    draw_results as draw_results,
)
from .picture import content_of as content_of, plot as plot, save as save
from .styles import COLOURS as COLOURS, STYLE as STYLE, new_figure as new_figure
