"""The command that reproduces the paper."""

from collections import Counter
from pathlib import Path
from typing import Annotated

import typer


def paper(
    figure: Annotated[str, typer.Option(help="1, 2, 3, 4, trust, hacking or all.")] = "all",
    seeds: Annotated[int, typer.Option(help="Seeds for everything that is learnt.")] = 30,
    out: Annotated[Path, typer.Option(help="Folder for the results.")] = Path("paper-results"),
    workers: Annotated[int | None, typer.Option(help="Threads; all processors by default.")] = None,
) -> None:
    """Reproduce the paper: figures, data, and a verdict on each of its claims.

    Writes index.html, claims.json, each figure as PNG and SVG and its data as Parquet. An
    interrupted run goes on where it was; a folder with results of other settings is refused.
    """
    from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    from curricle.paper.reproduce import FIGURES, reproduce

    columns = (SpinnerColumn(), TimeElapsedColumn(), TextColumn("{task.description}"))
    with Progress(*columns, transient=True) as progress:
        task = progress.add_task("starting", total=None)
        claims = reproduce(
            out,
            figures=FIGURES if figure == "all" else [figure],
            seeds=seeds,
            workers=workers,
            tick=lambda words: progress.update(task, description=words),
        )
    for claim in claims:
        typer.echo(f"{claim['verdict']:>15}  {claim['id']}")
    counts = Counter(claim["verdict"] for claim in claims)
    typer.echo(", ".join(f"{n} {verdict}" for verdict, n in counts.items()))
    typer.echo(f"Open {out / 'index.html'}")
