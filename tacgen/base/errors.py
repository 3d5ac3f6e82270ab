"""Errors that a user can fix; all others are bugs and keep their traceback."""

import re
import unicodedata
from collections.abc import Iterable


class UserError(Exception):
    """Messages for the user: the command prints them on stderr and exits with 2.

    A message is one line; indented lines under it (the offending source line and a caret) belong to it.
    """

    def __init__(self, messages: str | Iterable[str]) -> None:
        texts = [messages] if isinstance(messages, str) else list(messages)
        self.lines: tuple[str, ...] = tuple(printable(line) for text in texts for line in text.splitlines())
        super().__init__("\n".join(self.lines))

    def __reduce__(self) -> tuple[type["UserError"], tuple[list[str]]]:
        """Pickled, so that a worker process can return it."""
        return (type(self), (list(self.lines),))


class LeftOut(UserWarning):
    """Something of the user's is not part of what is read: commands print it, programs may turn it into an error."""


def printable(text: str) -> str:
    """Text for a terminal, with control characters and invalid characters escaped, except tab and newline.

    Names in untrusted files may contain terminal control sequences.
    """
    if text.isprintable():
        return text
    return re.sub("[^\t\n -~]", lambda m: m[0] if unicodedata.category(m[0])[0] != "C" else ascii(m[0])[1:-1], text)


def why(error: Exception) -> str:
    """The system's message about a file, without error number and file name."""
    return getattr(error, "strerror", None) or str(error)
