"""F1: the target states that Svetlik's mapping covers (paper E4)."""

from curricle import GridWorld
from curricle.paper.settings import Claim, FigureResult, Progress, stacked, verdict
from curricle.plotting import draw_maze, new_figure
from curricle.transfer import relative_objects

SOURCE = ["..T", ".P.", "..."]
TARGETS = {
    "target A": ["...T..", "..P...", ".....F", ".F....", "......", "S....."],
    "target B": ["...T..", "...P..", ".....F", ".F....", "......", "S....."],
}


def build(seeds: int, workers: int | None, progress: Progress) -> FigureResult:
    """Return figure 1; nothing is learnt, so `seeds` and `workers` are not used."""
    del seeds, workers
    source = GridWorld(SOURCE, start="uniform", representation="relative")
    targets = {name: GridWorld(text, representation="relative") for name, text in TARGETS.items()}
    mappings = {name: relative_objects(target, source) for name, target in targets.items()}
    figure, axes = new_figure(1, 3, width=9, height=3.4)
    draw_maze(axes[0, 0], source)
    axes[0, 0].set_title("source")
    parts = []
    for panel, (name, target) in zip(axes[0, 1:], targets.items(), strict=True):
        matched = mappings[name].mapped_states()
        draw_maze(panel, target, marked=matched)
        free = ~target.mdp.terminal
        panel.set_title(f"{name}: {matched.sum()} of {free.sum()} states matched")
        row, column = target.cells.T
        parts.append({"target": name, "row": row, "column": column, "matched": matched})
    progress("coverage of Svetlik's mapping")
    coverage = {name: mapping.coverage() for name, mapping in mappings.items()}
    shares = {name: cover.mapped for name, cover in coverage.items()}
    return FigureResult(
        name="figure1",
        title="Figure 1: what Svetlik's mapping covers",
        caption="Framed: states of two targets that match a state of the source under the "
        "relative-position representation. T treasure, P pit, F fire. Target B differs in one "
        "pit, so the source matches nowhere and no state gets a value. Exact; nothing is "
        "sampled.",
        figure=figure,
        tables={"figure1": stacked(parts)},
        claims=(
            Claim(
                "f1.coverage",
                "Svetlik's mapping gives values only to target states in which all objects of the "
                "source have the same relative positions; a target can get none",
                "a 3x3 source with one pit, two 6x6 targets",
                verdict(shares["target A"] > 0 and shares["target B"] == 0),
                {name: str(cover) for name, cover in coverage.items()},
            ),
        ),
        settings={"state": "positions of all objects relative to the agent (Svetlik et al. 2017)"},
    )
