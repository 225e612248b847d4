"""Escapes control characters in text from files: a name in a log may contain a terminal command."""

from __future__ import annotations


def printable(text: str, keep: str = "") -> str:
    """Escape control characters, line breaks and marks of the writing direction, like Python.

    Parameters
    ----------
    text
        Any text.
    keep
        Characters that are not escaped, such as line breaks.
    """
    if text.isprintable():
        return text
    return "".join(
        sign
        if sign.isprintable() or sign in keep
        else sign.encode("unicode_escape", "surrogatepass").decode()
        for sign in text
    )
