from .plots import (
    content_of as content_of,
    draw_curve as draw_curve,
    draw_maze as draw_maze,
    draw_potential as draw_potential,
    frame_cells as frame_cells,
    plot as plot,
    save as save,
)
from .report import render as render, write_report as write_report
from .style import COLOURS as COLOURS, STYLE as STYLE, new_figure as new_figure
