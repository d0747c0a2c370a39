from .choice_flips import collapse_figure as collapse_figure, draw_flips as draw_flips
from .grids import draw_maze as draw_maze, frame_cells as frame_cells
from .learning_curves import draw_curve as draw_curve
from .picture import content_of as content_of, plot as plot, save as save
from .potentials import draw_potential as draw_potential, draw_sources as draw_sources
from .styles import COLOURS as COLOURS, STYLE as STYLE, new_figure as new_figure
