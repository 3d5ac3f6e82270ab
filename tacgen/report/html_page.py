"""An HTML page that needs no other file: its frame, the one style of all pages, and scripts, which are files of this
folder."""

from collections.abc import Iterable, Mapping, Sequence
from html import escape
from importlib import resources


def asset(name: str) -> str:
    """The text of the style or of a script."""
    return resources.files("tacgen.report").joinpath(name).read_text(encoding="utf-8")


def page(title: str, body: str, policy: str = "") -> str:
    """The page; its `title` is HTML already, and `policy`, if any, is its content security policy."""
    guard = f'<meta http-equiv="Content-Security-Policy" content="{policy}">' if policy else ""
    head = f'<meta charset="utf-8">{guard}<meta name=viewport content="width=device-width, initial-scale=1">'
    head += f"<title>{title}</title><style>{asset('page.css')}</style>"
    return f"<!doctype html><html lang=en><head>{head}</head><body>{body}</body></html>"


def table(head: Sequence[str], rows: Iterable[Sequence[object]], *, raw: int = 0) -> str:
    """A table with a card's frame; the last `raw` cells of each row are HTML already."""
    top = "".join(f"<th>{escape(name)}</th>" for name in head)
    lines = []
    for row in rows:
        plain = len(row) - raw
        cells = [escape(str(cell)) if k < plain else str(cell) for k, cell in enumerate(row)]
        lines.append("<tr>" + "".join(f"<td>{cell}</td>" for cell in cells) + "</tr>")
    return f"<table class=card>{f'<tr>{top}</tr>' if top else ''}{''.join(lines)}</table>"


def choice(name: str, label: str, options: Mapping[str, str]) -> str:
    """A drop-down list with this id; `options`: value -> text."""
    shown = "".join(f'<option value="{escape(value)}">{escape(text)}</option>' for value, text in options.items())
    return f"<label>{escape(label)} <select id={name}>{shown}</select></label>"
