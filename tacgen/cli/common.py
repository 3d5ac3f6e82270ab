"""Shared by all commands: the app, error messages and exit codes, results as text or JSON."""

import errno
import math
import resource
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import click
import typer
from typer.core import TyperGroup

from tacgen.base import output_file, regular_file
from tacgen.base.errors import LeftOut, UserError, printable
from tacgen.base.terminal import dropping, open_standard_streams, say

Bundles = Annotated[Path, typer.Argument(help="A bundle, or a folder of bundles.")]
AsJson = Annotated[bool, typer.Option("--json", help="Print JSON.")]
Sets = Annotated[
    list[str] | None, typer.Option("--set", metavar="PATH=VALUE", help="Override a value; can be given many times.")
]
WORKERS_HELP = "Number of worker processes, one core each; auto: as cores and memory allow."
Workers = Annotated[str, typer.Option("--workers", "-j", metavar="N", help=WORKERS_HELP)]
Engine = Annotated[str, typer.Option(help="local: this machine; dask: a Dask cluster; cuda: a GPU.")]
Scheduler = Annotated[str, typer.Option(help="Address of a Dask scheduler, such as tcp://host:8786.")]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace an existing file.")]
DISK_ERROR_NUMBERS = (
    *(errno.ENOSPC, errno.EACCES, errno.EPERM, errno.EROFS, errno.ENOTDIR, errno.EISDIR, errno.EEXIST, errno.EDQUOT),
    *(errno.ENAMETOOLONG, errno.EFBIG, errno.EBUSY, errno.ENXIO),
)
MAX_SCENE_COUNT_DIGITS = 7  # of a number of scenes, which are a million at most
MIN_ADDRESS_SPACE_BYTES = 1_100_000_000  # of a small solve [bytes]; with much less, OpenBLAS ends the process
noted: set[str] = set()  # lines that this command has printed and a run need not repeat
SCARCITY_ERRORS = (errno.EMFILE, errno.ENFILE, errno.ENOMEM)


class Commands(TyperGroup):
    """Prints errors that a user can fix as lines and sets the exit code; bugs keep their traceback."""

    def main(self, *args: Any, **more: Any) -> Any:
        """The whole program."""
        open_standard_streams()
        try:
            return super().main(*args, **more)
        except OSError as error:
            if error.errno not in (*DISK_ERROR_NUMBERS, *SCARCITY_ERRORS):
                raise
            place = f"{error.filename}: " if error.filename else ""
            say(f"{place}{error.strerror}", err=True)
            with dropping(sys.stdout):  # what a full disk has not taken would fail again on exit, with another code
                sys.stdout.flush()
            sys.exit(2)

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Refuse what no file name can hold; only programs that call commands in their own process can give it."""
        if any("\0" in arg for arg in args):
            raise click.UsageError("an argument holds a NUL character")
        with _usage_printable():
            return super().parse_args(ctx, args)

    def invoke(self, ctx: click.Context) -> Any:
        """Run the command."""
        noted.clear()
        try:
            with _left_out_told(), _usage_printable(), regular_file.noting():
                return super().invoke(ctx)
        except UserError as error:
            for line in error.lines:
                say(line, err=True)
            raise typer.Exit(2) from None
        except (KeyboardInterrupt, SystemError, MemoryError, ImportError) as error:
            if (cause := _cause(error)) is None:
                raise
            if isinstance(cause, KeyboardInterrupt) and _threads_start():
                say("interrupted; finished scenes are kept, run again to go on", err=True)
                raise typer.Exit(130) from None
            say("out of memory: close other programs, or raise the limit (ulimit -v)", err=True)
            raise typer.Exit(2) from None


@contextmanager
def _usage_printable() -> Iterator[None]:
    """Escape control characters of arguments in the messages about them."""
    try:
        yield
    except click.UsageError as error:
        error.message = printable(error.message)  # type: ignore[misc]
        raise


@contextmanager
def _left_out_told() -> Iterator[None]:
    """Print LeftOut warnings as a line each; others as usual."""
    import warnings

    with warnings.catch_warnings():
        usual = warnings.showwarning
        warnings.simplefilter("always", LeftOut)

        def show(message: Warning | str, category: type[Warning], *more: Any) -> None:
            if issubclass(category, LeftOut):
                warn([str(message)])
            else:
                usual(message, category, *more)

        warnings.showwarning = show  # type: ignore[assignment]
        yield


def _cause(error: BaseException | None) -> BaseException | None:
    """Ctrl-C or lack of memory, which a SystemError of compiled code may hide; None for another error."""
    while error is not None:
        if isinstance(error, KeyboardInterrupt | MemoryError) or "failed to map segment" in str(error):
            return error
        error = error.__cause__ or error.__context__
    return None


def _threads_start() -> bool:
    """Whether a thread can be started. Where not, the signal of Ctrl-C may be OpenBLAS's, which raises it on failing to
    start its own."""
    import threading

    thread = threading.Thread(target=int)
    try:
        thread.start()
    except RuntimeError:
        return False
    thread.join()
    return True


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

    tell(json.dumps(plain, indent=1) if as_json else text)


def tell(text: str, *, end: bool = True) -> None:
    """Print a result, by default with a line end, or fail as the stream does; control characters are escaped."""
    typer.echo(printable(text), nl=end)


def line(event: dict[str, Any]) -> None:
    """Print an event as one line of JSON during the run, which goes on if nobody reads it."""
    import json

    say(json.dumps(event))


@contextmanager
def writing(place: Path) -> Iterator[None]:
    """Turn errors of the disk (full, read-only, no permission, no such place) into a UserError."""
    try:
        yield
    except OSError as error:
        if error.errno not in (*DISK_ERROR_NUMBERS, errno.ENOENT):
            raise
        raise UserError(f"{error.filename or place}: cannot be written: {error.strerror}") from None


@contextmanager
def written(out: Path, inputs: Iterable[Path], overwrite: bool, kind: output_file.Kind = "") -> Iterator[Path]:
    """A path to write to, which gets the name `out` when it is complete; errors as of `output_file.written`."""
    with writing(out), output_file.written(out, inputs, overwrite=overwrite, kind=kind) as path:
        yield path


def allowed(outs: Iterable[Path | None], inputs: Iterable[Path], overwrite: bool) -> None:
    """UserError, before long work, if one of `outs` could not be written afterwards, or two are one file."""
    given = [out for out in outs if out is not None]
    for out in given:
        output_file.refuse(out, inputs, overwrite=overwrite)
    if len({out.resolve() for out in given}) < len(given):
        raise UserError(f"{given[0]}: is to hold two results: give each a file of its own")


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
    """The plan of a recipe given by path or name, or a shard of it. Raises MemoryError: too little to solve any."""
    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    if limit != resource.RLIM_INFINITY and limit < MIN_ADDRESS_SPACE_BYTES:
        raise MemoryError
    from tacgen.base import array_cache
    from tacgen.recipe import assets, plan

    with array_cache.telling(_compiling):
        planned = plan.load(assets.recipe_path(recipe), sets or (), shard)
    warn(planned.warnings)
    return planned


def _compiling(kind: str) -> None:
    """Say, once, that code is compiled, which makes the first command on a machine wait."""
    from tacgen.base.compiled import COMPILED_ENTRY
    from tacgen.report.progress import COMPILING

    if kind == COMPILED_ENTRY and COMPILING not in noted:
        noted.add(COMPILING)
        say(COMPILING, err=True)


def warn(texts: Iterable[str]) -> None:
    """Print warnings."""
    for text in texts:
        say(f"warning: {text}", err=True)


def shard_of(text: str) -> tuple[int, int]:
    """`1/4` as numbers."""
    index, _, count = text.partition("/")
    if not _whole(index) < _whole(count):
        raise UserError(f"--shard {text}: must be I/N with I from 0 to N - 1, such as 0/4, 1/4, 2/4 and 3/4")
    return int(index), int(count)


def _whole(text: str) -> float:
    """A number of scenes or workers; nan for what is none, and for more digits than one can have."""
    return int(text) if text.isdecimal() and len(text) <= MAX_SCENE_COUNT_DIGITS else math.nan


def workers_of(text: str) -> int:
    """`8` or `auto` as a number."""
    if text == "auto":
        from tacgen.batch.worker_process import usual_workers

        return usual_workers()
    if not _whole(text) >= 1:
        raise UserError(f"--workers {text}: must be a number from 1, or auto")
    return int(text)


def made(plan: Any, folder: Path, *, as_json: bool = False, **how: Any) -> Any:
    """The results of a plan, whose scenes are made with a progress bar and, `as_json`, a line for each event.

    `how`: as of `batch.run`, and so the exceptions.
    """
    from tacgen import batch
    from tacgen.report.progress import Progress

    with Progress(len(plan.rows), sum(plan.frames), noted=noted) as progress:

        def on_event(event: dict[str, Any]) -> None:
            progress(event)
            if as_json:
                line(event)

        return batch.run(plan, folder, on_event=on_event, **how)


def priced(plan: Any, workers: int) -> dict[str, Any]:
    """Time some scenes of a plan; the estimated cost as JSON values, and as a sentence under `text`."""
    from tacgen.batch import probe
    from tacgen.report.progress import Progress

    rows = probe.chosen(plan)
    say(f"timing {len(rows)} of {len(plan.rows)} scenes, for {probe.TIMING_S:g} s at most", err=True)
    with Progress(len(rows), sum(row.frames for row in rows), noted=noted) as progress:
        cost, memory = probe.probe(plan, workers, on_event=progress)
    text = f"{cost.text(min(workers, len(plan.rows)))}; {memory:.2g} GB of memory a worker"
    return {**cost.plain(), "memory_gb": round(memory, 3), "workers": workers, "text": text}
