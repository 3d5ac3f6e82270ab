"""What every command shares: the app, errors as lines and exit codes, results for a person or a program."""

import errno
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import click
import typer
from typer.core import TyperGroup

from tacgen.errors import UserError, printable

DISK_ERRORS = tuple(
    getattr(errno, name)
    for name in (
        *("ENOSPC", "EACCES", "EPERM", "EROFS", "ENOTDIR", "EISDIR", "EEXIST", "EDQUOT", "ENAMETOOLONG", "EFBIG"),
        *("EBUSY", "ENXIO"),
    )
)
SCARCE = (errno.EMFILE, errno.ENFILE, errno.ENOMEM)


class Commands(TyperGroup):
    """Turns what a person can act on into lines and an exit code; bugs keep their traceback."""

    def invoke(self, ctx: click.Context) -> Any:
        """Run the command that was asked for."""
        try:
            return super().invoke(ctx)
        except UserError as error:
            for line in error.lines:
                typer.echo(line, err=True)
            raise typer.Exit(2) from None
        except MemoryError:
            typer.echo("out of memory: close other programs, or raise the limit (ulimit -v)", err=True)
            raise typer.Exit(2) from None
        except OSError as error:
            if error.errno not in (*DISK_ERRORS, *SCARCE):
                raise
            place = f"{error.filename}: " if error.filename else ""
            typer.echo(printable(f"{place}{error.strerror}"), err=True)
            raise typer.Exit(2) from None
        except (KeyboardInterrupt, SystemError) as error:
            if not _interrupted(error):
                raise
            typer.echo("interrupted; finished scenes are kept, run again to go on", err=True)
            raise typer.Exit(130) from None


def _interrupted(error: BaseException | None) -> bool:
    """Whether an error is Ctrl-C, which compiled code passes on as a SystemError that it caused."""
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__cause__ or error.__context__
    return error is not None


app = typer.Typer(
    cls=Commands,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    help="Declarative recipes in, labelled datasets of vision-based tactile sensors out.",
)


def show_result(plain: Any, text: str, as_json: bool) -> None:
    """Print a result for a person or a program."""
    import json

    typer.echo(json.dumps(plain, indent=1) if as_json else printable(text))


def line(event: dict[str, Any]) -> None:
    """Print an event for a program that listens while the run goes on."""
    import json

    typer.echo(json.dumps(event))


@contextmanager
def writing(place: Path) -> Iterator[None]:
    """A disk that is full, read-only or not ours is no bug: one line."""
    try:
        yield
    except OSError as error:
        if error.errno not in DISK_ERRORS:
            raise
        raise UserError(f"{error.filename or place}: cannot be written: {error.strerror}") from None


def probe(folder: Path) -> None:
    """Make the folder and write to it now, not after the first scene is solved."""
    import tempfile

    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder) as file:
            file.write(b"\0" * 4096)
    except OSError as error:  # whatever stands in the way, it is the folder that must be another
        raise UserError(f"{folder}: cannot be written: {error.strerror}") from None
