from .choice_flips import collapse_figure as collapse_figure, draw_flips as draw_flips
from .comparison import draw_comparison as draw_comparison
from .forecast import draw_forecast as draw_forecast
from .picture import plot as plot
from .potentials import draw_potential as draw_potential, draw_sources as draw_sources
