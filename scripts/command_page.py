"""Print docs/COMMANDS.md, generated from the command line: python scripts/command_page.py > docs/COMMANDS.md"""

import inspect
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any, get_args, get_type_hints

import click
import typer

from tacgen.cli.main import app

PLAIN = {"TEXT", "PATH"}  # metavars that say no more than the help
COMMON = ("--set", "--workers", "--overwrite", "--json")  # options told once, where a command says no more of them
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

Options of many commands:

| option | what |
|---|---|
"""


def page() -> str:
    """docs/COMMANDS.md, made from the commands of `tacgen`."""
    group = typer.main.get_command(app)
    assert isinstance(group, click.Group)
    context = click.Context(group, info_name="tacgen")
    commands = dict(leaves(group, ""))
    lines = [HEAD + "\n".join(common().values())]
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
    rows, shared, told = [], list[str](), common()
    for parameter in command.params:
        name, text = parameter.opts[0], cell(texts[parameter.name])
        if told.get(name, "").endswith(f"| {text} |"):
            value = default(parameter, isinstance(parameter, click.Option) and parameter.is_flag)
            shared.append(f"`{name}`" + (f" (default {value})" if value else ""))
        else:
            rows.append(row(parameter, context, text))
    lines += ["", "| option | default | what |", "|---|---|---|", *rows] if rows else []
    return [*lines, "", f"Also {', '.join(shared)}."] if shared else lines


@cache
def common() -> dict[str, str]:
    """Lines on the COMMON options, as a command that has all of them tells them."""
    group = typer.main.get_command(app)
    assert isinstance(group, click.Group)
    command = group.commands["touch"]
    context, texts = click.Context(command, info_name="touch"), helps(command.callback)
    found = {one.opts[0]: one for one in command.params if one.opts[0] in COMMON}
    return {name: row(found[name], context, texts[found[name].name], brief=True) for name in COMMON}


def helps(callback: Any) -> dict[str, str]:
    """The help of each parameter as tacgen/cli/main.py writes it: click drops that of arguments."""
    hints = get_type_hints(inspect.unwrap(callback), include_extras=True)
    return {name: next((str(note.help) for note in get_args(hint)[1:]), "") for name, hint in hints.items()}


def row(parameter: click.Parameter, context: click.Context, text: str, *, brief: bool = False) -> str:
    """A line of the table; a brief one has no default."""
    flag = isinstance(parameter, click.Option) and parameter.is_flag
    metavar = parameter.make_metavar(context)
    if isinstance(parameter, click.Argument):
        named = f"`{metavar}`"
    else:
        named = ", ".join(f"`{name}`" for name in parameter.opts) + (
            "" if flag or metavar in PLAIN else f" `{metavar}`"
        )
    return f"| {cell(named)} |{'' if brief else f' {default(parameter, flag)} |'} {cell(text)} |"


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
