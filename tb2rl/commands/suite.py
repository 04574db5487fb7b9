"""The command `evaluate --suite`, see `tb2rl.evaluate`."""

from __future__ import annotations

import argparse
from contextlib import nullcontext
from dataclasses import asdict
from pathlib import Path
from typing import Any

from tb2rl.commands.evaluate import check_shared
from tb2rl.commands.output import write_json
from tb2rl.commands.policy import chosen_policy
from tb2rl.commands.robot import chosen_robot
from tb2rl.core.compiled import announce_compiling
from tb2rl.core.errors import InputError
from tb2rl.core.values import build
from tb2rl.evaluation.progress import progress
from tb2rl.evaluation.spaces import check_observes
from tb2rl.evaluation.suite_result import Drive
from tb2rl.evaluation.suites import SuiteEvaluation, drives_of, suite_evaluator, suite_scene
from tb2rl.execution.arguments import make_executor
from tb2rl.runs.config import Config
from tb2rl.runs.folder import Run
from tb2rl.runs.journal import Journal
from tb2rl.runs.layers import parse_settings
from tb2rl.runs.loading import policy_digest
from tb2rl.runs.versions import versions
from tb2rl.viz.table import print_suite
from tb2rl.worlds.suites import Suite, find_suite


def run(options: argparse.Namespace) -> None:
    """Drive a policy through a suite, print a table, write JSON."""
    announce_compiling()
    check(options)
    suite = find_suite(options.suite[0], Path(options.suite[1]) if options.suite[1:] else None)
    policy, config = chosen_policy(options)
    scene = suite_scene(config.scene, suite)
    check_observes(policy, scene)
    about = _about(options)
    executor = make_executor(options) if options.on else None
    with executor or nullcontext(), suite_evaluator(scene, 1 if executor else options.workers) as evaluator:
        file = _result_file(options, suite)
        journal = _journal(file, suite, config, {**about, "simulation": evaluator.simulator.name})
        drives = _finished_drives(journal, len(suite.worlds))
        rest = drives_of(evaluator, policy, len(drives), executor)
        for drive in progress(rest, "evaluating", "world", total=len(suite.worlds) - len(drives)):
            journal.append(asdict(drive))
            drives.append(drive)
        result = SuiteEvaluation(suite, scene, drives, evaluator.simulator.name).result(config, **about)
    if file is not None:
        write_json(file, asdict(result))
    journal.remove()
    print_suite(result)


def check(options: argparse.Namespace) -> None:
    """Raise an `InputError` if options contradict each other."""
    check_shared(options)
    chosen_robot(options)  # refuses options of a robot
    if len(options.suite) > 2:
        raise InputError("--suite takes a name, and for barn a path; name the policy before it")
    reasons = {
        "simulation": "suites are driven in PyBullet if it is installed",
        "goal": "each of its worlds has a goal",
        **dict.fromkeys(("episodes", "steps", "seed"), "a suite defines its episodes"),
    }
    for name, reason in reasons.items():
        if getattr(options, name) is not None:
            raise InputError(f"--{name} does not go with --suite: {reason}")
    if "task.episode_steps" in parse_settings(options.set):
        raise InputError("task.episode_steps does not go with --suite: each suite has a time limit")


def _about(options: argparse.Namespace) -> dict[str, Any]:
    """The policy's name and the digest of its file; an agent that does not learn has no digest."""
    if options.agent is not None:
        return {"policy": f"agent {options.agent}", "policy_digest": None}
    return {"policy": str(options.policy), "policy_digest": policy_digest(options.policy, options.trust)}


def _result_file(options: argparse.Namespace, suite: Suite) -> Path | None:
    """The file of `--json`, or that of the run folder if its own task is driven."""
    if options.json:
        return Path(options.json)
    if options.policy and Path(options.policy).is_dir() and not options.set:
        return Run.open(Path(options.policy), options.trust).suite_file(suite.name)
    return None


def _journal(file: Path | None, suite: Suite, config: Config, about: dict[str, Any]) -> Journal:
    """The journal beside the result, which holds the drives until all are done."""
    path = None if file is None else file.with_name(f"{file.name}.journal")
    rules = {"name": suite.name, "digest": suite.digest, "time": suite.time_limit, "goal_radius": suite.goal_radius}
    return Journal(path, {**about, "suite": rules, "config": config.to_dict(), "versions": versions()})


def _finished_drives(journal: Journal, worlds: int) -> list[Drive]:
    """The drives in a journal; prints whether the suite continues."""
    drives = [build(Drive, entry, f"{journal.path}: line {line}") for line, entry in enumerate(journal.entries, 2)]
    if [drive.world for drive in drives] != list(range(len(drives))):
        raise InputError(f"{journal.path} does not hold one world after the other; remove it to start again")
    if journal.path is None:
        print("not kept: a run folder keeps the results of its own task only; --json FILE writes any result")
    elif journal.mismatch is not None:
        print(f"starting again: {journal.path} was of another {journal.mismatch}")
    elif drives:
        print(f"continuing: {len(drives)} of {worlds} worlds are in {journal.path}")
    return drives
