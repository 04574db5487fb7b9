"""Tries untrusted files in a separate process, which may hang, crash or exhaust memory without the tests.

    python tests/runs/untrusted RUNS FAMILY FIRST WORK LINES

RUNS: a folder with a run of each agent; FAMILY: "damage COUNT" or "states"; FIRST: number of the first case; WORK: a
working folder; LINES: gets a line of JSON before and after each case.
"""

from __future__ import annotations

import faulthandler
import json
import resource
import shutil
import sys
import threading
from collections.abc import Callable, Iterator
from itertools import islice
from pathlib import Path
from typing import Any

from damage import damage
from states import states
from surgery import Case, agents, checkpoint_of

from tb2rl.core.errors import InputError
from tb2rl.runs.loading import load
from tb2rl.training.training import resume

MEMORY = 2 * 2**30  # [bytes] of address space beyond that of a process that has loaded valid files
LONGEST = 10  # [s] for a file


def main(runs: str, family: str, first: str, work: str, lines: str) -> None:
    """Try the cases of a family from number `first` on."""
    faulthandler.enable()
    folder = Path(work)
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    for agent in agents(Path(runs)):  # the memory that valid files need does not count
        shutil.copytree(Path(runs, agent), folder / agent)
        load(checkpoint_of(folder, agent))
        resume(folder / agent)
        shutil.rmtree(folder / agent)
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + MEMORY, resource.RLIM_INFINITY))
    begin = int(first)
    with Path(lines).open("a", buffering=1) as report:
        for number, case in enumerate(islice(cases(Path(runs), family), begin, None), begin):
            about = {"number": number, "name": case.name, "agent": case.agent}
            report.write(json.dumps(about) + "\n")
            report.write(json.dumps({**about, **outcome(case, Path(runs), folder)}) + "\n")


def cases(runs: Path, family: str) -> Iterator[Case]:
    name, _, count = family.partition(" ")
    return damage(runs, int(count)) if name == "damage" else states(runs)


def outcome(case: Case, runs: Path, folder: Path) -> dict[str, Any]:
    file = folder / "policy.safetensors"
    file.write_bytes(case.content)
    found = attempt(load, file)
    if case.resumes and found["outcome"] != "failed":
        run = shutil.copytree(runs / case.agent, folder / "run")
        checkpoint_of(folder, "run").write_bytes(case.content)
        found = {**attempt(resume, run), "attempt": "resume"}
        for thread in threading.enumerate():  # a failed training leaves threads that write event files
            if hasattr(thread, "stop"):
                thread.stop()
        shutil.rmtree(run)
    return found


def attempt(function: Callable[[Path], Any], path: Path) -> dict[str, Any]:
    """Outcome of reading a file: "works", "refused" in one line with its path, or "failed"."""
    faulthandler.dump_traceback_later(LONGEST, exit=True)
    try:
        function(path)
        found = {"outcome": "works"}
    except InputError as error:
        clean = len(str(error).splitlines()) == 1 and str(path) in str(error)
        found = {"outcome": "refused" if clean else "failed", "error": f"InputError: {error}"[:400]}
    except BaseException as error:  # a panic of safetensors is no Exception
        trace, places = error.__traceback__, []
        while trace:
            places.append(f"{Path(trace.tb_frame.f_code.co_filename).name}:{trace.tb_lineno}")
            trace = trace.tb_next
        found = {"outcome": "failed", "error": f"{type(error).__name__}: {error}"[:400], "where": places[-6:]}
    finally:
        faulthandler.cancel_dump_traceback_later()
    return {**found, "attempt": function.__name__}


if __name__ == "__main__":
    main(*sys.argv[1:])
