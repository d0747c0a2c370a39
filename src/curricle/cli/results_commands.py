"""Commands that read the results of studies: show, report, compare."""

from pathlib import Path
from typing import Annotated

import typer

Folder = Annotated[Path, typer.Argument(help="A study's folder.", show_default=False)]


def show(
    folder: Folder,
    decisions: Annotated[bool, typer.Option(help="Why each task went on or stopped.")] = False,
    arm: Annotated[str | None, typer.Option(help="Of this arm only.")] = None,
    task: Annotated[str | None, typer.Option(help="Of this task only.")] = None,
    seed: Annotated[int | None, typer.Option(help="Of this seed only.")] = None,
) -> None:
    """Print a study's progress, what each task learnt, and the comparison of its arms."""
    from curricle.cli.results_tables import decision_lines, print_results
    from curricle.study.results import StudyResults

    results = StudyResults(folder)
    if not decisions:
        print_results(results, arm, task)
        return
    for line in decision_lines(results, arm, task, seed):
        typer.echo(line)


def report(
    folder: Folder,
    out: Annotated[
        Path | None, typer.Option(help="The page; report.html in the folder by default.")
    ] = None,
) -> None:
    """Write a study's report, one HTML page that works offline."""
    from curricle.report.study_report import write_report

    typer.echo(f"Open {write_report(folder, out)}")


def compare(
    folders: Annotated[
        list[Path], typer.Argument(help="Folders of studies of one target.", show_default=False)
    ],
) -> None:
    """Compare the arms of several studies of one target with learning it from scratch."""
    from curricle.study.results import StudyResults, compare_studies

    typer.echo(str(compare_studies([StudyResults(folder) for folder in folders])))
