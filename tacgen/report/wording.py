"""Numbers in words."""


def counted(n: int, noun: str) -> str:
    """`1 scene`, `2 scenes`."""
    return f"{n} {noun}" + ("" if n == 1 else "s")
