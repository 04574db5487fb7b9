"""Implementation of `python -m tb2rl.report`: a page of runs, suite results and bags."""

import argparse
from pathlib import Path

from tb2rl.calibration.replay import Replay, replay
from tb2rl.commands.arguments import refuse
from tb2rl.commands.worlds import only_world
from tb2rl.core import InputError, check_output, write_text
from tb2rl.core.files import parse_yaml
from tb2rl.deploy.bags.reading import is_bag, parse_topics, read_drive
from tb2rl.envs.scene import Scene
from tb2rl.evaluation.progress import progress
from tb2rl.evaluation.suite_comparison import read_results
from tb2rl.robots.robot_file import is_robot_file
from tb2rl.runs import config_of, load, resolve
from tb2rl.simulation.simulator import default_simulator
from tb2rl.viz.comparison import compare, comparison_page, read_compared_runs
from tb2rl.viz.drives import DriveSection, drive_section
from tb2rl.viz.page import page
from tb2rl.viz.run_views import display_names, group_runs, read_run_view, run_folders
from tb2rl.viz.suites import result_files, suite_sections

_LATENCY_STEP = 0.005  # [s] to which the latencies of a robot file are rounded


def run(arguments: argparse.Namespace) -> None:
    """Write the page and print its path."""
    if arguments.compare:
        _compare(arguments)
        return
    bags = [path for path in dict.fromkeys(map(Path, arguments.runs)) if is_bag(path)]
    files = [path for path in map(Path, arguments.runs) if path not in bags and path.is_file()]
    folders = run_folders([reference for reference in arguments.runs if Path(reference) not in [*bags, *files]])
    out = _page_file(arguments)
    drives = _drive_sections(arguments, bags)
    results = [(file, read_results(file)) for file in result_files(files, folders)]
    named_folders = list(zip(folders, display_names(folders), strict=True))
    bar = progress(named_folders, "reading", "run")
    groups = group_runs([read_run_view(folder, name, progress_bar=True, trust=arguments.trust) for folder, name in bar])
    suites = [section for file, each in results for section in suite_sections(file, each, progress_bar=True)]
    text = page(groups, suites, drives, progress_bar=True)
    write_text(out, text)
    counts = {"run": len(folders), "suite": len(results), "bag": len(drives)}
    content = ", ".join(f"{count} {name}{'s' * (count > 1)}" for name, count in counts.items() if count)
    print(f"{out}: {content}, {len(text.encode()) / 1e6:.1f} MB")


def _compare(arguments: argparse.Namespace) -> None:
    """Compare two folders of runs, print the verdicts and write the page."""
    refuse(arguments, "cannot be combined with --compare", "topics", "world", "against")
    if len(arguments.runs) != 2:
        raise InputError("--compare takes two folders of runs")
    first, second = (set(run_folders([reference])) for reference in arguments.runs)
    if first & second:
        raise InputError(f"--compare takes two different sets of runs, but {min(first & second)} is in both")
    out = _page_file(arguments)
    first_runs, second_runs = (read_compared_runs(reference, arguments.trust) for reference in arguments.runs)
    comparisons = compare(first_runs, second_runs)
    for comparison in comparisons:
        means = (f"{100 * e.value:.1f} % ({100 * e.low:.1f} to {100 * e.high:.1f} %)" for e in comparison.means)
        print(f"{comparison.title}: {' and '.join(means)}. {comparison.verdict}")
    write_text(out, comparison_page(first_runs, second_runs, comparisons))
    print(out)


def _drive_sections(arguments: argparse.Namespace, bags: list[Path]) -> list[DriveSection]:
    topics, world = parse_topics(arguments.topics), None
    if not bags:
        refuse(arguments, "is for bags, but there is no bag among the arguments", "topics", "world", "against")
    if arguments.world:
        world = only_world(parse_yaml(arguments.world, "--world"), "--world")
    scene = _scene_against(arguments) if arguments.against else None
    sections = []
    for bag in progress(bags, "reading", "bag"):
        drive, replays = read_drive(bag, topics, scans=scene is not None), dict[str, Replay]()
        if scene is not None:
            replays[arguments.against] = replay(drive, scene, default_simulator(), world)
            print(f"{bag} against {arguments.against}: {replays[arguments.against]}")
        sections.append(drive_section(drive, world, replays))
    return sections


def _scene_against(arguments: argparse.Namespace) -> Scene:
    """The scene with the robot and the variation of `--against`: a robot file, or the training of a policy."""
    reference = arguments.against
    if is_robot_file(reference):
        settings = {"task.robot": reference, "task.variation": reference, "task.control_period": _LATENCY_STEP}
        return resolve("random", "drive", settings=settings).scene
    return config_of(load(reference, arguments.trust)).scene


def _page_file(arguments: argparse.Namespace) -> Path:
    """The output file; raises an `InputError` before the slow work if it cannot be written."""
    only_path = Path(arguments.runs[0]) if len(arguments.runs) == 1 else Path()
    out = arguments.out or (only_path if only_path.is_dir() else Path()) / "report.html"
    check_output(out)
    return out
