"""The executor that a command line chooses: `--on ray`, `--on ray:ADDRESS`, `--workers 4`."""

from __future__ import annotations

import argparse

from tb2rl.core.errors import InputError, one_line
from tb2rl.execution.executor import Executor

_MAX_WORKERS = 10_000


def add_executor_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments that `make_executor` reads."""
    parser.add_argument("--on", metavar="ray[:ADDRESS]", help="run on Ray: on this machine, or on a cluster's address")
    parser.add_argument("--workers", type=int, help="parallel processes (default: one for each processor)")


def make_executor(options: argparse.Namespace) -> Executor:
    """The executor of a command line; it starts its workers when they are first needed.

    Raises:
        InputError: If an argument does not fit.
    """
    if options.workers is not None and not 1 <= options.workers <= _MAX_WORKERS:
        raise InputError(f"--workers must be from 1 to {_MAX_WORKERS}, got {options.workers}")
    if options.on is None:
        from tb2rl.execution.local import LocalExecutor

        return LocalExecutor(options.workers)
    engine, colon, address = options.on.partition(":")
    if engine != "ray" or (colon and not address):
        raise InputError(one_line(f"--on takes ray, or ray:ADDRESS such as ray:10.0.0.1:6379, got {options.on!r}"))
    from tb2rl.execution.cluster import RayExecutor

    return RayExecutor(address or None, options.workers)


def executor_arguments(options: argparse.Namespace) -> list[str]:
    """The words of a command line that choose the same executor."""
    on = [] if options.on is None else ["--on", options.on]
    return on if options.workers is None else [*on, "--workers", str(options.workers)]
