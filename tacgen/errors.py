"""Errors that a person can act on; everything else is a bug and keeps its traceback."""

import unicodedata
from collections.abc import Iterable


class UserError(Exception):
    """Messages for the person at the keyboard: the command prints them on stderr and exits with 2.

    A message is one line; indented lines under it (the offending source line and a caret) belong to it.
    """

    def __init__(self, messages: str | Iterable[str]) -> None:
        texts = [messages] if isinstance(messages, str) else list(messages)
        self.lines: tuple[str, ...] = tuple(printable(line) for text in texts for line in text.splitlines())
        super().__init__("\n".join(self.lines))

    def __reduce__(self) -> tuple[type["UserError"], tuple[list[str]]]:
        """Survive the trip back from a worker process."""
        return (type(self), (list(self.lines),))


def printable(text: str) -> str:
    """Text for a terminal: control characters and what is no character stand in it as escapes, all but tab and newline.

    Names in files of others may hold what colours, clears or renames a terminal.
    """
    if text.isprintable():
        return text
    return "".join(c if c in "\t\n" or unicodedata.category(c)[0] != "C" else ascii(c)[1:-1] for c in text)


def why(error: Exception) -> str:
    """What the system said of a file, without its number and name; or what else was wrong with the path."""
    return getattr(error, "strerror", None) or str(error)
