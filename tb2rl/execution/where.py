"""Where jobs are done, as a command line says it: `--on ray`, `--on ray:ADDRESS`, `--workers 4`."""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from typing import TYPE_CHECKING

from tb2rl.core.errors import InputError, one_line
from tb2rl.core.processes import processors

if TYPE_CHECKING:
    from tb2rl.execution.running import Workers

_MOST = 10_000


@dataclass(frozen=True)
class Where:
    """Where jobs are done.

    Attributes:
        ray: Whether Ray does them, or else processes of this machine.
        address: Of Ray's cluster; None: one that is started for it on this machine.
        workers: How many at once; None: one for each processor, here or in the cluster.
    """

    ray: bool = False
    address: str | None = None
    workers: int | None = None

    @property
    def words(self) -> list[str]:
        """The arguments of a command line that mean it."""
        ray = ["--on", "ray" if self.address is None else f"ray:{self.address}"] if self.ray else []
        return ray if self.workers is None else [*ray, "--workers", str(self.workers)]

    def open(self, shared: object) -> Workers:
        """The workers.

        Args:
            shared: What all jobs share, which can be pickled.

        Raises:
            InputError: If Ray is not installed, or there is no cluster at its address.
        """
        if not self.ray:
            from tb2rl.execution.local import Processes

            return Processes(self.workers or processors(), shared)
        from tb2rl.execution.cluster import Cluster

        return Cluster(self.address, self.workers, shared)


def add_where(parser: argparse.ArgumentParser) -> None:
    """The arguments that `where_of` reads."""
    parser.add_argument("--on", metavar="ray[:ADDRESS]", help="let Ray do it: here, or on the cluster of an address")
    parser.add_argument("--workers", type=int, help="how many at once (default: one for each processor)")


def where_of(options: argparse.Namespace) -> Where:
    """Where the arguments of a command line say that jobs are done.

    Raises:
        InputError: If they say what cannot be.
    """
    if options.workers is not None and not 1 <= options.workers <= _MOST:
        raise InputError(f"--workers must be from 1 to {_MOST}, got {options.workers}")
    if options.on is None:
        return Where(workers=options.workers)
    engine, colon, address = options.on.partition(":")
    if engine != "ray" or (colon and not address):
        raise InputError(one_line(f"--on takes ray, or ray:ADDRESS such as ray:10.0.0.1:6379, got {options.on!r}"))
    return Where(True, address or None, options.workers)
