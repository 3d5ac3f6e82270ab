"""Print docs/COMMANDS.md, generated from the command line: python scripts/command_page.py > docs/COMMANDS.md"""

import inspect
from collections.abc import Iterator
from pathlib import Path
from typing import Any, get_args, get_type_hints

import click
import typer

from tacgen.cli.common import AsJson, Overwrite, Sets, Workers
from tacgen.cli.main import app

COMMON = {"--set PATH=VALUE": Sets, "--workers N, -j N": Workers, "--overwrite": Overwrite, "--json": AsJson}
SHARED = {usage: get_args(hint)[1].help for usage, hint in COMMON.items()}  # helps that are told once
PLAIN = {"TEXT", "PATH"}  # metavars that say no more than the help
HEAD = """# Commands

Generated from the command line by `python scripts/command_page.py > docs/COMMANDS.md`; do not edit.

Results go to stdout, progress and errors to stderr. Every command takes `-h` and `--help`.

| exit code | meaning |
|---|---|
| 0 | done |
| 1 | `run`: scenes were rejected or failed; `status`: not every scene is done; `check`: findings, notes apart |
| 1 | `doctor`: something needed does not work |
| 2 | an error in the recipe or in the arguments |
| 130 | interrupted; finished scenes are kept, and the same command resumes |
"""


def page() -> str:
    """docs/COMMANDS.md, made from the commands of `tacgen`."""
    group = typer.main.get_command(app)
    assert isinstance(group, click.Group)
    context = click.Context(group, info_name="tacgen")
    commands = dict(leaves(group, ""))
    lines = [HEAD, "Options of many commands:\n", *(f"- `{usage}`: {text}" for usage, text in SHARED.items())]
    for name, command in commands.items():
        lines += ["", f"## tacgen {name}", "", *section(command, click.Context(command, context, name))]
    return "\n".join(lines) + "\n"


def leaves(group: click.Group, prefix: str) -> Iterator[tuple[str, click.Command]]:
    """Every command by its full name, those of groups too."""
    for name in sorted(group.commands):
        command = group.commands[name]
        if isinstance(command, click.Group):
            yield from leaves(command, f"{prefix}{name} ")
        else:
            yield prefix + name, command


def section(command: click.Command, context: click.Context) -> list[str]:
    """Usage, help and the table of one command's parameters."""
    lines = [" ".join((command.help or "").split())]
    texts = helps(command.callback)
    also = [one for one in command.params if texts[one.name] in SHARED.values()]
    rows = [row(one, context, texts[one.name]) for one in command.params if one not in also]
    lines += ["", "| option | default | what |", "|---|---|---|", *rows] if rows else []
    named = [f"`{one.opts[0]}`{f' (default `{one.default}`)' if one.default in ('1', 'auto') else ''}" for one in also]
    return [*lines, "", f"Also {', '.join(named)}."] if also else lines


def helps(callback: Any) -> dict[str, str]:
    """The help of each parameter as tacgen/cli/main.py writes it: click drops that of arguments."""
    hints = get_type_hints(inspect.unwrap(callback), include_extras=True)
    return {name: next((str(note.help) for note in get_args(hint)[1:]), "") for name, hint in hints.items()}


def row(parameter: click.Parameter, context: click.Context, text: str) -> str:
    """A line of the table."""
    flag = isinstance(parameter, click.Option) and parameter.is_flag
    metavar = parameter.make_metavar(context)
    if isinstance(parameter, click.Argument):
        named = f"`{metavar}`"
    else:
        shown = "" if flag or metavar in PLAIN else f" `{metavar}`"
        named = ", ".join(f"`{name}`" for name in parameter.opts) + shown
    return f"| {cell(named)} | {default(parameter, flag)} | {cell(text)} |"


def default(parameter: click.Parameter, flag: bool) -> str:
    """The value where nothing is given; empty if there is none."""
    if parameter.required:
        return "required"
    value = parameter.default
    if flag or value is None or value == "" or callable(value) or not isinstance(value, str | int | float | Path):
        return ""
    return f"`{value}`"


def cell(text: str) -> str:
    """Text that may stand in a table."""
    return " ".join(text.split()).replace("|", "\\|")


if __name__ == "__main__":
    print(page(), end="")
