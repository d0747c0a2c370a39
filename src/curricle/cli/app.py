"""The command, its exit codes, and errors as one sentence.

=====  =============================================================================
0      done
1      Curricle refused: a file, a folder or a setting is not as it must be
2      the command line makes no sense
3      the study's own code failed; what was stored before is whole
130    interrupted; what was stored before is whole
=====  =============================================================================
"""

import os
import sys
import traceback
from typing import Any

import typer
from typer.core import TyperGroup

from curricle.cli import paper, reading, running


class _Commands(TyperGroup):
    """The commands, left at once when interrupted."""

    def invoke(self, ctx: Any) -> Any:
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt:
            typer.echo("curricle: interrupted; what was stored before is whole", err=True)
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(130)  # units still in compiled loops would be waited for


app = typer.Typer(
    cls=_Commands,
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    help="Curriculum learning by potential-based reward shaping.",
    epilog="Exit codes: 0 done, 1 refused, 2 misused, 3 the study's own code failed, "
    "130 interrupted.",
)


@app.callback()
def _root() -> None:
    """Curriculum learning by potential-based reward shaping."""


for command in (
    paper.paper,
    running.new,
    running.check,
    running.run,
    running.merge,
    running.schema,
    reading.show,
    reading.report,
    reading.compare,
):
    app.command()(command)


def main() -> None:
    """Run the command; Curricle's own errors become one sentence and an exit code."""
    from curricle.errors import CurricleError, StudyError

    try:
        app(standalone_mode=True)
    except CurricleError as error:
        failed = isinstance(error, StudyError) and error.__cause__ is not None
        if failed:
            traceback.print_exception(error.__cause__)
        typer.echo(f"curricle: {error}", err=True)
        sys.exit(3 if failed else 1)
