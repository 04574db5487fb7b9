"""Errors of users, and how commands report them: one line and exit status 2."""

from __future__ import annotations

import argparse
import difflib
import functools
import io
import os
import select
import sys
import warnings
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import Any, NoReturn


class InputError(ValueError):
    """Wrong input; the message is one line and names what is allowed."""


class UnwritableError(InputError):
    """A full disk or a folder without write permission, which no setting can fix."""


class WorldWarning(UserWarning):
    """A reader of a world left something out or chose a value; a command shows it as one line."""


class UnknownArgumentError(InputError, TypeError):
    """An unknown keyword argument, in Python's own words because some libraries look for them."""

    def __init__(self, function: str, name: str = "", known: Iterable[str] = ()) -> None:
        # Gymnasium creates the error again with its own longer message as the only argument.
        text = f"{function}() got an unexpected keyword argument {name!r}"
        super().__init__(f"{text}: {unknown('setting', name, known)}" if name else function)


def one_line(message: object, longest: int = 400) -> str:
    """A message without line breaks, cut to `longest` characters because it can repeat long input."""
    text = " ".join(str(message).split())
    return text if len(text) <= longest else f"{text[:longest]} ..."


def unknown(kind: str, name: object, known: Iterable[str]) -> InputError:
    """The error for a name that does not exist: it suggests the nearest one and lists all."""
    known = sorted(known)
    near = difflib.get_close_matches(str(name), known, n=1)
    suggestion = f" did you mean {near[0]!r}?" if near else ""
    return InputError(f"unknown {kind} {one_line(repr(name), 200)};{suggestion} known: {', '.join(known)}")


def install_extra(extra: str) -> str:
    """The command that installs an extra of `pyproject.toml`, for a message."""
    return f'pip install -c constraints.txt -e ".[{extra}]" (in the checkout of tb2rl)'


class ArgumentParser(argparse.ArgumentParser):
    """Reports a wrong argument as an `InputError`."""

    def error(self, message: str) -> NoReturn:
        raise InputError(f"{message} (see --help)")


def command(main: Callable[[list[str] | None], None]) -> Callable[..., None]:
    """Decorate a command's `main`: wrong input and unusable files end it with one line on stderr and status 2.

    If the reader of its output goes away (`| head`), the command ends silently. Characters that the terminal's encoding
    lacks are printed escaped; output to a stream that was closed from the start (`2>&-`) is dropped.
    """

    @functools.wraps(main)
    def guarded(arguments: list[str] | None = None) -> None:
        _repair_streams()
        try:
            with _one_line_warnings():
                _run(main, arguments)
        except (BrokenPipeError, SystemExit) as error:
            if not _reader_left(error):
                raise
            for stream in (1, 2):  # the interpreter flushes its buffers when it ends
                os.dup2(os.open(os.devnull, os.O_WRONLY), stream)
            raise SystemExit(141) from None  # as a shell reports it: 128 + SIGPIPE

    return guarded


def _run(main: Callable[[list[str] | None], None], arguments: list[str] | None) -> None:
    try:
        main(arguments)
    except InputError as error:
        _stop(f"error: {error}")
    except OSError as error:
        if error.filename is None:  # not about a file
            raise
        _stop(f"error: {error.strerror}: {error.filename}")
    except UnicodeEncodeError as error:
        if error.object.isprintable():
            raise
        _stop(f"error: the name {one_line(ascii(error.object), 200)} is not text in {error.encoding}; use another one")
    except KeyboardInterrupt:
        raise SystemExit(130) from None  # as a shell reports it: 128 + SIGINT
    finally:
        print(end="", flush=True)  # raises BrokenPipeError here, not when the interpreter ends


def _repair_streams() -> None:
    """Let any text be printed, and open the streams that were closed when Python started, which are None."""
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        stream = getattr(sys, name)
        if stream is None:
            try:
                os.fstat(number)
            except OSError:  # the next file to be opened would get this number, and what libraries print
                os.dup2(os.open(os.devnull, os.O_RDWR), number)
            setattr(sys, name, open(os.devnull, "w" if number else "r"))  # noqa: SIM115, PTH123 (until the end)
        elif number and isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


@contextmanager
def _one_line_warnings() -> Iterator[None]:
    """Show each `WorldWarning` as one line; other warnings as usual."""
    usual = warnings.showwarning

    def show(message: Warning | str, category: type[Warning], *place: Any, **options: Any) -> None:
        if issubclass(category, WorldWarning):
            print(" ".join(f"warning: {message}".split()), file=sys.stderr)
        else:
            usual(message, category, *place, **options)

    warnings.showwarning = show
    try:
        yield
    finally:
        warnings.showwarning = usual


def _reader_left(error: BaseException) -> bool:
    """Whether nobody reads our output any more; pipes to our own processes can break, too."""
    if isinstance(error, SystemExit):
        return isinstance(error.__context__, BrokenPipeError)  # rich turns one into the other
    if not hasattr(select, "poll"):  # Windows
        return True
    output = select.poll()
    for stream in (1, 2):
        output.register(stream, 0)
    return any(event & (select.POLLERR | select.POLLHUP) for _, event in output.poll(0))


def _stop(line: str) -> NoReturn:
    print(" ".join(line.split()), file=sys.stderr)
    raise SystemExit(2)
