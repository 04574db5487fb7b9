"""Tries bad files in a process of its own, which may hang, crash or ask for all memory without taking the tests along.

    python tests/runs/strangers RUNS FAMILY FIRST WORK LINES

RUNS: a folder with a run of each agent; FAMILY: "pickles AGENT", "damage COUNT", "claims" or "states"; FIRST: number of
the case to begin with; WORK: a folder to work in; LINES: gets a line of JSON before and after each case.
"""

from __future__ import annotations

import faulthandler
import json
import resource
import shutil
import sys
import threading
import time
from collections.abc import Callable, Iterator
from itertools import islice
from pathlib import Path
from typing import Any

from claims import claims, states
from damage import damage
from pickles import pickles
from surgery import Case, agents, checkpoint_of

from tb2rl.core.errors import InputError
from tb2rl.runs.loading import load
from tb2rl.training.training import resume

MEMORY = 2 * 2**30  # [bytes] of address space that a file may cost on top of a process that has loaded good ones
LONGEST = 10  # [s] that a file may take


def main(runs: str, family: str, first: str, work: str, lines: str) -> None:
    """Try the cases of a family from number `first` on."""
    faulthandler.enable()
    folder = Path(work)
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    for agent in agents(Path(runs)):  # what good ones need is not what bad ones cost
        shutil.copytree(Path(runs, agent), folder / agent)
        load(checkpoint_of(folder, agent))
        resume(folder / agent)
        shutil.rmtree(folder / agent)
    resource.setrlimit(resource.RLIMIT_AS, (address_space() + MEMORY, resource.RLIM_INFINITY))
    begin = int(first)
    with Path(lines).open("a", buffering=1) as report:
        for number, case in enumerate(islice(cases(Path(runs), family, folder / "executed"), begin, None), begin):
            about = {"number": number, "name": case.name, "agent": case.agent}
            report.write(json.dumps(about) + "\n")
            report.write(json.dumps({**about, **outcome(case, Path(runs), folder)}) + "\n")


def cases(runs: Path, family: str, marker: Path) -> Iterator[Case]:
    name, _, rest = family.partition(" ")
    if name == "pickles":
        return pickles(runs, rest, marker)
    if name == "damage":
        return damage(runs, int(rest))
    return claims(runs) if name == "claims" else states(runs)


def outcome(case: Case, runs: Path, folder: Path) -> dict[str, Any]:
    file = folder / "policy.safetensors"
    file.write_bytes(case.content)
    found = attempt(load, file)
    if case.resumes and found["outcome"] != "failed":
        run = shutil.copytree(runs / case.agent, folder / "run")
        checkpoint_of(folder, "run").write_bytes(case.content)
        found = {**attempt(resume, run), "attempt": "resume"}
        stop_writers()
        shutil.rmtree(run)
    executed = (folder / "executed").exists()
    if executed:
        (folder / "executed").rmdir()
    return {**found, "executed": executed}


def attempt(what: Callable[[Path], Any], path: Path) -> dict[str, Any]:
    """What comes of reading a file: it works, or is refused in one line that names it, else it failed."""
    started = time.monotonic()
    faulthandler.dump_traceback_later(LONGEST, exit=True)
    try:
        what(path)
        found = {"outcome": "works"}
    except InputError as error:
        clean = len(str(error).splitlines()) == 1 and str(path) in str(error)
        found = {"outcome": "refused" if clean else "failed", "error": f"InputError: {error}"}
    except BaseException as error:  # a panic of safetensors is no Exception
        found = {"outcome": "failed", "error": f"{type(error).__name__}: {error}", "where": where(error)}
    finally:
        faulthandler.cancel_dump_traceback_later()
    found["error"] = found.get("error", "")[:400]
    return {**found, "attempt": what.__name__, "seconds": round(time.monotonic() - started, 2)}


def stop_writers() -> None:
    """Stop the threads that write event files, which a training that failed leaves behind."""
    for thread in threading.enumerate():
        if hasattr(thread, "stop"):
            thread.stop()


def where(error: BaseException) -> list[str]:
    """The innermost lines that an exception came through."""
    trace, lines = error.__traceback__, []
    while trace:
        lines.append(f"{Path(trace.tb_frame.f_code.co_filename).name}:{trace.tb_lineno}")
        trace = trace.tb_next
    return lines[-6:]


def address_space() -> int:
    """[bytes]"""
    return int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()


if __name__ == "__main__":
    main(*sys.argv[1:])
