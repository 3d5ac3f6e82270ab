"""An HTML page that needs no other file: its frame, and the styles and scripts, which are files of this folder."""

from importlib import resources


def asset(name: str) -> str:
    """The text of a style or a script."""
    return resources.files("tacgen.report").joinpath(name).read_text(encoding="utf-8")


def page(title: str, style: str, body: str, policy: str = "") -> str:
    """The page; its `title` is HTML already, and `policy`, if any, is its content security policy."""
    guard = f'<meta http-equiv="Content-Security-Policy" content="{policy}">' if policy else ""
    head = f'<meta charset="utf-8">{guard}<title>{title}</title><style>{style}</style>'
    return f"<!doctype html><html lang=en><head>{head}</head><body>{body}</body></html>"
