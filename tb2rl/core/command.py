"""Commands: parse a command line, call a function, and report errors as one line with exit status 2."""

import argparse
import functools
import io
import os
import select
import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, NoReturn

from tb2rl.core.errors import InputError, WorldWarning, one_line
from tb2rl.core.plugins import import_object
from tb2rl.core.processes import process_context, processors


class ArgumentParser(argparse.ArgumentParser):
    """Raises an `InputError` for an invalid argument."""

    def error(self, message: str) -> NoReturn:
        raise InputError(f"{message} (see --help)")


@dataclass(frozen=True)
class Command:
    """The `main` function of a command: parses the arguments, and calls the function that `options.run` references.

    The default of `options.run` is `tb2rl.commands.NAME:run`; `add_arguments` can set another one. The function is
    imported after parsing, so that `--help` does not wait for slow imports.
    """

    name: str
    add_arguments: Callable[[ArgumentParser], None]
    uses_workers: bool = False  # whether it has `--simulation` and `--workers`, and the default simulator needs workers

    def parser(self) -> ArgumentParser:
        """A parser of command lines."""
        docstring = str(self.add_arguments.__globals__["__doc__"])
        parser = ArgumentParser(prog=f"python -m tb2rl.{self.name}", description=docstring.splitlines()[0])
        parser.set_defaults(run=f"tb2rl.commands.{self.name}:run")
        self.add_arguments(parser)
        return parser

    def parse(self, arguments: list[str] | None = None) -> argparse.Namespace:
        """Parse a command line, by default that of the program."""
        return self.parser().parse_args(arguments)

    def __call__(self, arguments: list[str] | None = None) -> None:
        with report_errors():
            options = self.parse(arguments)
            if self.uses_workers and options.simulation is None and (options.workers or processors()) > 1:
                process_context()  # the fork server imports torch while this process does
            import_object(vars(options).pop("run"))(options)


def command(name: str, uses_workers: bool = False) -> Callable[[Callable[[ArgumentParser], None]], Command]:
    """Make a decorator that replaces a function `main(parser)`, which only fills the parser, by a `Command`.

    The first line of its module's docstring is the description in `--help`.
    """
    return functools.partial(Command, name, uses_workers=uses_workers)


def between(low: float, high: float, number_type: type[int] | type[float] = int) -> Callable[[str], float]:
    """Make an argument type for `argparse`: a number from `low` to `high`."""

    def number(text: str) -> float:
        value = number_type(text)
        if not low <= value <= high:
            raise argparse.ArgumentTypeError(f"must be from {low} to {high}, got {value}")
        return value

    return number


@contextmanager
def report_errors() -> Iterator[None]:
    """Report an `InputError` or a file error in the block as one line on stderr, with exit status 2.

    If the program that reads our output ends (`| head`), this program ends silently. Characters that the terminal
    cannot encode are escaped. Output to a stream that was closed at the start (`2>&-`) is discarded.
    """
    _repair_streams()
    try:
        with warnings.catch_warnings(), _exit_on_error():
            warnings.showwarning = functools.partial(_show_warning, warnings.showwarning)
            yield
    except (BrokenPipeError, SystemExit) as error:
        if not _is_reader_gone(error):
            raise
        for descriptor in (1, 2):  # because the interpreter flushes stdout and stderr at exit
            os.dup2(os.open(os.devnull, os.O_WRONLY), descriptor)
        raise SystemExit(141) from None  # the status in a shell, 128 + SIGPIPE


@contextmanager
def _exit_on_error() -> Iterator[None]:
    try:
        yield
    except InputError as error:
        _fail(f"error: {error}")
    except OSError as error:
        if error.filename is None:  # not a file error
            raise
        _fail(f"error: {error.strerror}: {error.filename}")
    except UnicodeEncodeError as error:
        if error.object.isprintable():  # not a file name with undecodable bytes, which are not printable
            raise
        _fail(f"error: the name {one_line(ascii(error.object), 200)} is not text in {error.encoding}; use another one")
    except KeyboardInterrupt:
        raise SystemExit(130) from None  # the status in a shell, 128 + SIGINT
    finally:
        print(end="", flush=True)  # so that a BrokenPipeError is raised here, not at exit


def _fail(message: str) -> NoReturn:
    print(" ".join(message.split()), file=sys.stderr)
    raise SystemExit(2)


def _repair_streams() -> None:
    """Escape characters that a stream cannot encode, and open streams that were closed at the start."""
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        stream = getattr(sys, name)
        if stream is None:
            # `open` takes the lowest free descriptor, that of the closed stream. Otherwise the next opened file would
            # get it, and native libraries would write their output to that file.
            descriptor = os.open(os.devnull, os.O_RDWR)
            os.set_inheritable(descriptor, True)
            setattr(sys, name, os.fdopen(descriptor, "w" if number else "r"))
        elif number and isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def _show_warning(default: Callable[..., None], message: Any, category: type[Warning], *location: Any) -> None:
    """Show a `WorldWarning` as one line, and other warnings by the `default` function."""
    if issubclass(category, WorldWarning):
        print(" ".join(f"warning: {message}".split()), file=sys.stderr)
    else:
        default(message, category, *location)


def _is_reader_gone(error: BaseException) -> bool:
    """Whether the program that reads our output has ended; a pipe to a child process can raise the same errors."""
    if isinstance(error, SystemExit):
        return isinstance(error.__context__, BrokenPipeError)  # rich converts a BrokenPipeError to a SystemExit
    if not hasattr(select, "poll"):  # Windows
        return True
    poll = select.poll()
    for descriptor in (1, 2):
        poll.register(descriptor, 0)
    return any(event & (select.POLLERR | select.POLLHUP) for _, event in poll.poll(0))
