"""Errors that a user can correct, and their messages."""

import difflib
from collections.abc import Iterable


class InputError(ValueError):
    """Invalid input; the message is one line, which includes what is allowed."""


class UnwritableError(InputError):
    """A destination that cannot be written, such as a full disk."""


class WorldWarning(UserWarning):
    """Something in a world file was ignored or assumed; commands show the warning as one line."""


class UnknownArgumentError(InputError, TypeError):
    """An unknown keyword argument; the message begins like Python's own, because some libraries search for it."""

    def __init__(self, function: str, name: str = "", known: Iterable[str] = ()) -> None:
        # Gymnasium copies the error, and passes a longer message as the only argument, `function`.
        text = f"{function}() got an unexpected keyword argument {name!r}"
        super().__init__(f"{text}: {unknown('setting', name, known)}" if name else function)


def one_line(message: object, max_length: int = 400) -> str:
    """Remove line breaks from a message, and truncate it to `max_length` characters."""
    text = " ".join(str(message).split())
    return text if len(text) <= max_length else f"{text[:max_length]} ..."


def unknown(kind: str, name: object, known: Iterable[str]) -> InputError:
    """Make the error for an unknown name, which suggests the most similar known name and lists all known names."""
    known = sorted(known)
    similar = difflib.get_close_matches(str(name), known, n=1)
    suggestion = f" did you mean {similar[0]!r}?" if similar else ""
    return InputError(f"unknown {kind} {one_line(repr(name), 200)};{suggestion} known: {', '.join(known)}")


def install_extra(extra: str) -> str:
    """The shell command that installs an extra of `pyproject.toml`, for messages."""
    return f'pip install -c constraints.txt -e ".[{extra}]" (in the checkout of tb2rl)'
