"""Bags of a policy that drives, one an episode."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import closing
from pathlib import Path
from typing import Any

from tb2rl.deploy.bags.recorded import RecordedEnv
from tb2rl.deploy.bags.recorder import check_bag, open_bag
from tb2rl.evaluation.moments import Policy, time_limit
from tb2rl.evaluation.progress import progress as progress_bar
from tb2rl.runs.config import Config
from tb2rl.simulation import default_simulator
from tb2rl.viz.film import STEPS, Listener, check_numbers, drives, open_scene


def record(
    policy: Policy | str | Path,
    path: str | Path,
    config: Config | None = None,
    settings: Mapping[str, Any] | None = None,
    *,
    episodes: int = 1,
    steps: int | None = None,
    seed: int = 0,
    listener: Listener | None = None,
    progress: bool = False,
    simulation: str | None = None,
) -> list[Path]:
    """Record a policy at what it was trained to do; what is in a bag: see `tb2rl.deploy.bags.recorder`.

    Args:
        path: A file .bag for ROS 1, or a folder for ROS 2; of several episodes each has a number behind that name.
        policy, config, settings, episodes, steps, seed, listener, progress: As in `tb2rl.viz.film.film`.
        simulation: "bullet" or "kinematic"; None: as in `film`.

    Returns:
        The bags.

    Raises:
        InputError: If anything of this does not fit, a bag cannot be written, or `rosbags` is not installed.
    """
    paths = [check_bag(each) for each in _numbered(Path(path), episodes)]
    steps = time_limit(steps, settings or {}, STEPS)
    check_numbers(episodes, steps, seed)
    policy, scene = open_scene(policy, config, settings or {}, steps)
    env = RecordedEnv(scene, simulation=simulation or default_simulator())
    bar = progress_bar(None, "recording", "step", total=episodes * steps, shown=progress)
    with closing(env), bar:
        for each, moments in zip(paths, drives(env, policy, episodes, seed, listener), strict=True):
            with open_bag(each, scene) as env.recorder:
                for _ in moments:
                    bar.update()
    return paths


def _numbered(path: Path, episodes: int) -> list[Path]:
    if episodes == 1:
        return [path]
    return [path.with_name(f"{path.stem}-{number + 1}{path.suffix}") for number in range(episodes)]
