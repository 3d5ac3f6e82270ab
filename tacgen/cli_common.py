"""Shared by all commands: the app, error messages and exit codes, results as text or JSON."""

import errno
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import click
import typer
from typer.core import TyperGroup

from tacgen.errors import UserError, printable

AsJson = Annotated[bool, typer.Option("--json", help="Print JSON.")]
DISK_ERRORS = tuple(
    getattr(errno, name)
    for name in (
        *("ENOSPC", "EACCES", "EPERM", "EROFS", "ENOTDIR", "EISDIR", "EEXIST", "EDQUOT", "ENAMETOOLONG", "EFBIG"),
        *("EBUSY", "ENXIO"),
    )
)
SCARCE = (errno.EMFILE, errno.ENFILE, errno.ENOMEM)


class Commands(TyperGroup):
    """Prints errors that a user can fix as lines and sets the exit code; bugs keep their traceback."""

    def invoke(self, ctx: click.Context) -> Any:
        """Run the command."""
        try:
            return super().invoke(ctx)
        except UserError as error:
            for line in error.lines:
                typer.echo(line, err=True)
            raise typer.Exit(2) from None
        except (MemoryError, ImportError) as error:
            if isinstance(error, ImportError) and "failed to map segment" not in str(error):
                raise
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
    """Whether an error is Ctrl-C, or a SystemError that it caused in compiled code."""
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
    """Print a result as text or JSON."""
    import json

    typer.echo(json.dumps(plain, indent=1) if as_json else printable(text))


def line(event: dict[str, Any]) -> None:
    """Print an event as one line of JSON during the run."""
    import json

    typer.echo(json.dumps(event))


@contextmanager
def writing(place: Path) -> Iterator[None]:
    """Turn errors of the disk (full, read-only, no permission, no such place) into a UserError."""
    try:
        yield
    except OSError as error:
        if error.errno not in (*DISK_ERRORS, errno.ENOENT):
            raise
        raise UserError(f"{error.filename or place}: cannot be written: {error.strerror}") from None


def probe(folder: Path) -> None:
    """Create the folder and test that it can be written, before the first scene is solved."""
    import tempfile

    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder) as file:
            file.write(b"\0" * 4096)
    except OSError as error:  # whatever the reason, another folder is needed
        raise UserError(f"{folder}: cannot be written: {error.strerror}") from None


def plan_of(recipe: str, sets: list[str] | None, shard: tuple[int, int] = (0, 1)) -> Any:
    """The plan of a recipe given by path or name, or a shard of it."""
    from tacgen.recipe import assets, plan

    found = plan.load(assets.recipe_path(recipe), sets or (), shard)
    warn(found.warnings)
    return found


def warn(texts: Iterable[str]) -> None:
    """Print warnings."""
    for text in texts:
        typer.echo(f"warning: {text}", err=True)


def shard_of(text: str) -> tuple[int, int]:
    """`1/4` as numbers."""
    index, slash, count = text.partition("/")
    if not (slash and index.isdecimal() and count.isdecimal() and int(index) < int(count)):
        raise UserError(f"--shard {text}: must be I/N with I from 0 to N - 1, such as 0/4, 1/4, 2/4 and 3/4")
    return int(index), int(count)


def workers_of(text: str) -> int:
    """`8` or `auto` as a number."""
    if text == "auto":
        from tacgen.batch.worker_process import usual_workers

        return usual_workers()
    if not text.isdecimal() or int(text) < 1:
        raise UserError(f"--workers {text}: must be a number from 1, or auto")
    return int(text)


def priced(plan: Any, workers: int) -> dict[str, Any]:
    """Time some scenes of a plan; the estimated cost as JSON values, and as a sentence under `text`."""
    from tacgen.batch import probe

    typer.echo("timing a few scenes", err=True)
    cost, memory = probe.probe(plan, workers)
    text = f"{cost.text(min(workers, len(plan.rows)))}; {memory:.2g} GB of memory a worker"
    return {**cost.plain(), "memory_gb": round(memory, 3), "workers": workers, "text": text}
