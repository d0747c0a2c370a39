"""The command, its exit codes, and errors as one sentence.

=====  =============================================================================
0      done
1      a file, a folder or a setting was refused
2      the command line was wrong
3      the study's own code failed, its cluster was lost, or its results cannot be
       written any more; what was stored is whole
130    interrupted; what was stored before is whole
=====  =============================================================================
"""

import os
import sys
import traceback
from importlib.metadata import version
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from curricle.cli.commands import COMMANDS


class _Commands(TyperGroup):
    """The commands, which end at once when interrupted."""

    def invoke(self, ctx: Any) -> Any:
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt:
            typer.echo("curricle: interrupted; what was stored before is whole", err=True)
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(130)  # or Python would wait for units in compiled loops


app = typer.Typer(
    cls=_Commands,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    help="Curriculum learning by potential-based reward shaping.",
    epilog="Exit codes: 0 done, 1 refused, 2 wrong command line, 3 the study's own code failed, "
    "its cluster was lost or its results cannot be written any more, 130 interrupted.",
)


def _print_version(wanted: bool) -> None:
    """Print the version and end, if that is wanted."""
    if wanted:
        typer.echo(f"curricle {version('curricle')}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool,
        typer.Option(
            "--version", callback=_print_version, is_eager=True, help="Print the version."
        ),
    ] = False,
) -> None:
    pass


for command in COMMANDS:
    app.command()(command)


def main() -> None:
    """Run the command; errors of the library become one sentence and an exit code."""
    from curricle.errors import CurricleError, EngineError, LostStoreError, StudyError

    try:
        app(standalone_mode=True)
    except CurricleError as error:
        failed = isinstance(error, StudyError) and error.__cause__ is not None
        if failed:
            traceback.print_exception(error.__cause__)
        typer.echo(f"curricle: {error}", err=True)
        lost = isinstance(error, EngineError | LostStoreError)
        sys.exit(3 if failed or lost else 1)
    except OSError as error:  # of a path that the command line names
        named = f"{error.filename} cannot be used: " if error.filename else ""
        typer.echo(f"curricle: {named}{error.strerror or error}", err=True)
        sys.exit(1)
    except MemoryError:
        typer.echo("curricle: there is not enough memory for this study on this machine", err=True)
        sys.exit(1)
