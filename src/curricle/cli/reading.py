"""Commands that read what a study left: show, report, compare."""

from pathlib import Path
from typing import Annotated

import typer

Folder = Annotated[Path, typer.Argument(help="A study's folder.", show_default=False)]


def show(
    folder: Folder,
    decisions: Annotated[bool, typer.Option(help="Why each task went on and ended.")] = False,
    arm: Annotated[str | None, typer.Option(help="Of this arm only.")] = None,
    node: Annotated[str | None, typer.Option(help="Of this task only.")] = None,
    seed: Annotated[int | None, typer.Option(help="Of this seed only.")] = None,
) -> None:
    """Print a study's tables: how far it is, what each task learnt, what paid."""
    from curricle.cli.tables import decision_lines, study_lines
    from curricle.study.runner.study import Study

    study = Study(folder)
    lines = decision_lines(study, arm, node, seed) if decisions else study_lines(study, arm, node)
    for line in lines:
        typer.echo(line)


def report(
    folder: Folder,
    out: Annotated[
        Path | None, typer.Option(help="Where to; report.html in the folder by default.")
    ] = None,
) -> None:
    """Write a study's report, one HTML page that needs no network."""
    from curricle.report.study_report import write_report

    typer.echo(f"Open {write_report(folder, out)}")


def compare(
    folders: Annotated[
        list[Path], typer.Argument(help="Folders of studies of one target.", show_default=False)
    ],
) -> None:
    """Compare the arms of several studies of one target with learning it directly."""
    from curricle.study.runner.study import Study, compared

    typer.echo(str(compared([Study(folder) for folder in folders])))
