"""What a user can get wrong, and how a command says so: one line and exit status 2."""

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
    """Foreign input that does not fit: the message is one line and names what is allowed."""


class UnwritableError(InputError):
    """The disk is full, or a folder cannot be written: nothing that other settings would mend."""


class WorldWarning(UserWarning):
    """What a reader of a world left out or chose by itself; a command shows it as one line."""


class UnknownArgumentError(InputError, TypeError):
    """A keyword argument that a function does not take, in Python's own words: some libraries look for them."""

    def __init__(self, function: str, name: str = "", known: Iterable[str] = ()) -> None:
        # Gymnasium makes the error anew with one argument, its own longer message.
        what = f"{function}() got an unexpected keyword argument {name!r}"
        super().__init__(f"{what}: {unknown('setting', name, known)}" if name else function)


def one_line(message: object, longest: int = 400) -> str:
    """A message without line breaks, cut where it repeats too much of what came in."""
    text = " ".join(str(message).split())
    return text if len(text) <= longest else f"{text[:longest]} ..."


def unknown(kind: str, name: object, known: Iterable[str]) -> InputError:
    """The error for a name that does not exist: suggests the nearest one and lists all."""
    known = sorted(known)
    near = difflib.get_close_matches(str(name), known, n=1)
    suggestion = f" did you mean {near[0]!r}?" if near else ""
    return InputError(f"unknown {kind} {one_line(repr(name), 200)};{suggestion} known: {', '.join(known)}")


def install_extra(extra: str) -> str:
    """The command that installs an extra of `pyproject.toml`, for a message; tb2rl is installed from its checkout."""
    return f'pip install -c constraints.txt -e ".[{extra}]" (in the checkout of tb2rl)'


class ArgumentParser(argparse.ArgumentParser):
    """One that reports a wrong argument as an `InputError`."""

    def error(self, message: str) -> NoReturn:
        raise InputError(f"{message} (see --help)")


def command(main: Callable[[list[str] | None], None]) -> Callable[..., None]:
    """Let a command's `main` report wrong input, or a file it cannot use, as one line on stderr with status 2.

    Where the reader of its output goes away (`| head`), it ends without a word. What the encoding of the terminal lacks
    is printed escaped, and what goes to a stream that was closed from the start (`2>&-`) is dropped.
    """

    @functools.wraps(main)
    def guarded(arguments: list[str] | None = None) -> None:
        _repair_streams()
        try:
            with _warnings_in_a_line():
                _reporting(main, arguments)
        except (BrokenPipeError, SystemExit) as error:
            if not _reader_left(error):
                raise
            for stream in (1, 2):  # what is still buffered goes nowhere when the interpreter ends
                os.dup2(os.open(os.devnull, os.O_WRONLY), stream)
            raise SystemExit(141) from None  # as the shell counts it: 128 + SIGPIPE

    return guarded


def _reporting(main: Callable[[list[str] | None], None], arguments: list[str] | None) -> None:
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
        raise SystemExit(130) from None  # as the shell counts it: 128 + SIGINT
    finally:
        print(end="", flush=True)  # here, where a reader that left can be noticed, not when the interpreter ends


def _repair_streams() -> None:
    """Let any text be printed, and open the streams that were closed when Python started, which are None."""
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        stream = getattr(sys, name)
        if stream is None:
            _open_descriptor(number)
            setattr(sys, name, open(os.devnull, "w" if number else "r"))  # noqa: SIM115, PTH123 (until the end)
        elif number and isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def _open_descriptor(number: int) -> None:
    """Take a free number of a standard stream, or the next file gets it, and what libraries print."""
    try:
        os.fstat(number)
    except OSError:
        os.dup2(os.open(os.devnull, os.O_RDWR), number)


@contextmanager
def _warnings_in_a_line() -> Iterator[None]:
    """Show what a reader of a world warns about as a command shows its errors, and other warnings as ever."""
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
    """Whether an error means that nobody reads our output any more. Pipes to processes of our own can break, too."""
    if isinstance(error, SystemExit):
        return isinstance(error.__context__, BrokenPipeError)  # rich makes the one of the other
    if not hasattr(select, "poll"):  # Windows
        return True
    output = select.poll()
    for stream in (1, 2):
        output.register(stream, 0)
    return any(event & (select.POLLERR | select.POLLHUP) for _, event in output.poll(0))


def _stop(line: str) -> NoReturn:
    print(" ".join(line.split()), file=sys.stderr)
    raise SystemExit(2)
