"""Command-line arguments that select an executor: `--on ray`, `--on ray:ADDRESS`, `--workers 4`."""

import argparse

from tb2rl.core.command import between
from tb2rl.core.errors import InputError, one_line
from tb2rl.execution.executor import Executor


def add_executor_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments that `make_executor` reads."""
    parser.add_argument("--on", metavar="ray[:ADDRESS]", help="run on Ray, here or on the cluster at ADDRESS")
    workers_help = "parallel processes (default: one for each processor)"
    parser.add_argument("--workers", type=between(1, 10_000), help=workers_help)


def make_executor(options: argparse.Namespace) -> Executor:
    """Make the executor that a command line selects; the executor starts workers when they are first needed.

    Raises:
        InputError: If `--on` is invalid.
    """
    if options.on is None:
        from tb2rl.execution.local import LocalExecutor

        return LocalExecutor(options.workers)
    engine, colon, address = options.on.partition(":")
    if engine != "ray" or (colon and not address):
        raise InputError(one_line(f"--on takes ray, or ray:ADDRESS such as ray:10.0.0.1:6379, got {options.on!r}"))
    from tb2rl.execution.cluster import RayExecutor

    return RayExecutor(address or None, options.workers)
