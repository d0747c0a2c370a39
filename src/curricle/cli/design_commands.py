"""The commands that design a recipe and apply it."""

from pathlib import Path
from shlex import quote
from typing import Annotated, Any

import typer

from curricle.cli.options import Changes, announce_imports, write_new


def design(
    file: Annotated[
        Path, typer.Argument(help="A family and its miniatures, a TOML file.", show_default=False)
    ],
    budget: Annotated[int, typer.Option(min=0, help="Steps of all trainings together, at most.")],
    on: Annotated[str, typer.Option(help="The table of the file with the members.")] = "miniatures",
    out: Annotated[Path, typer.Option(help="The recipe.")] = Path("recipe.toml"),
    seed: Annotated[int, typer.Option(min=0, help="The same seed, the same recipe.")] = 0,
    workers: Annotated[
        int | None, typer.Option(min=1, help="Threads; all processors by default.")
    ] = None,
    resume: Annotated[bool, typer.Option(help="Go on with a design that was interrupted.")] = False,
    changes: Changes = None,
) -> None:
    """Design a recipe on small members of a family: which sources, and how long each.

    Every training is kept beside the recipe, so that an interrupted design goes on with --resume.
    Beside it is a page too, on how it was found.
    """
    from curricle.cli.progress_bars import and_compilation
    from curricle.progress import shown
    from curricle.report.design_report import write_design_report
    from curricle.study.recipes.designing import run_design

    announce_imports()
    given: Any = {"budget": budget, "seed": seed, "workers": workers, "set": changes or []}
    with shown(True, and_compilation(str)) as bars:
        found = run_design(file, on, out, **given, resume=resume, progress=bars)
    typer.echo(str(found))
    typer.echo(f'Wrote {out}: curricle apply {out} --to "PARAMETER=VALUE, ..."')
    page = out.with_suffix(".html" if out.suffix != ".html" else ".report.html")
    typer.echo(f"Open {write_design_report(found, page)}")


def apply(
    recipe: Annotated[Path, typer.Argument(help="The recipe, a TOML file.", show_default=False)],
    to: Annotated[str, typer.Option(help="The member by its parameters: size=10, predators=3.")],
    budget: Annotated[int, typer.Option(min=1, help="Steps of the target.")] = 200_000,
    seeds: Annotated[int, typer.Option(min=1, help="How many.")] = 30,
    out: Annotated[Path, typer.Option(help="The study.")] = Path("study.toml"),
) -> None:
    """Write the study of one member of a recipe's family, to be read, changed and run."""
    from curricle.study import read_recipe, study_text
    from curricle.study.recipes.designing import parameters_of

    announce_imports()
    stored = read_recipe(recipe)
    text = study_text(stored, parameters_of(to), budget=budget, seeds=seeds, file=out)
    write_new(out, text, "study")
    if not stored.recipe.stages:
        typer.echo("The recipe has no sources: the study learns the target alone.")
    typed = quote(str(out))
    typer.echo(f"Wrote {out}: curricle check {typed}, then curricle run {typed}")
