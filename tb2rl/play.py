"""Watch a policy drive, in PyBullet's window or in a film, or drive the robot yourself.

    python -m tb2rl.play runs/maze/dqn/NAME
    python -m tb2rl.play zoo:maze-loop-ppo --video drive.mp4 --camera chase
    python -m tb2rl.play --agent wallfollower --set task.maze=circuit
    python -m tb2rl.play --teleop --task wall

The window shows the drive as fast as it would happen. Without a display there is a film instead.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import sys
import time
from collections.abc import Iterable, Iterator
from contextlib import closing, suppress
from pathlib import Path

import numpy as np

from tb2rl.checkpoint import SUFFIX
from tb2rl.config import Config, parse_settings, resolve
from tb2rl.driving import Moment, Policy
from tb2rl.envs import TurtleBot2Env
from tb2rl.errors import ArgumentParser, InputError, command
from tb2rl.evaluate import add_policy_arguments, task_settings
from tb2rl.evaluation import with_task
from tb2rl.film import CAMERAS, STEPS, check_film, check_numbers, drive_all, film, goal_of, open_world, shots
from tb2rl.maze import Maze
from tb2rl.processes import main_hidden
from tb2rl.runs import config_of, load, make_baseline
from tb2rl.simulation.bullet import show
from tb2rl.tasks import Task
from tb2rl.teleop import Teleop, steer_in_terminal

_WINDOW_RATE = 30  # poses a second
_OPENING = 60.0  # [s] that a window may take to open


class Window:
    """PyBullet's window in a process of its own, which PyBullet ends as it likes.

    Args:
        maze: The maze to show.
        task: Its goal is shown, if it has one.
        camera: "above" looks at the whole maze, "chase" over the robot's shoulder.

    Raises:
        InputError: If the window cannot be opened.
    """

    def __init__(self, maze: Maze, task: Task, camera: str = "above") -> None:
        context = multiprocessing.get_context("spawn")  # clean, and without torch: it opens in a second
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(target=show, args=(theirs, maze, goal_of(task), camera == "chase"), daemon=True)
        with main_hidden():
            self._process.start()
        theirs.close()
        if not self._has_opened():
            self.close()
            raise InputError(
                "PyBullet's window does not open on this display, it needs OpenGL; --video FILE.mp4 writes a film, "
                "and without the variable DISPLAY nothing asks for a window"
            )

    def show(self, pose: np.ndarray) -> bool:
        """Show the robot at a pose (3,); False once the user has closed the window."""
        try:
            self._pipe.send(pose)
        except OSError:
            return False
        return True

    def close(self) -> None:
        """Close the window."""
        with suppress(OSError):
            self._pipe.send(None)
        self._process.join(timeout=5.0)
        self._process.kill()
        self._pipe.close()

    def _has_opened(self) -> bool:
        try:
            return self._pipe.poll(_OPENING) and self._pipe.recv()
        except (EOFError, OSError):  # the process has ended
            return False


def has_display() -> bool:
    """Whether windows can be expected to open; only on Linux a variable tells."""
    return not sys.platform.startswith("linux") or bool(os.environ.get("DISPLAY"))


def watch(env: TurtleBot2Env, drives: Iterable[Iterator[Moment]], window: Window, speed: float) -> None:
    """Show episodes in a window, `speed` times as fast as they happened, until the user closes it."""
    for moments in drives:
        due = time.monotonic()
        for shot in shots(moments, env.task.control_period, _WINDOW_RATE, speed):
            if not window.show(shot.pose):
                return
            due += 1 / _WINDOW_RATE
            time.sleep(max(0.0, due - time.monotonic()))


def parse(arguments: list[str] | None) -> argparse.Namespace:
    """The command line."""
    parser = ArgumentParser(prog="python -m tb2rl.play", description=(__doc__ or "").splitlines()[0])
    add_policy_arguments(parser)
    parser.add_argument("--teleop", action="store_true", help="instead: drive it yourself, by the terminal's keys")
    parser.add_argument("--episodes", type=int, default=1)
    parser.add_argument("--steps", type=int, default=STEPS, help=f"control steps at most in an episode ({STEPS})")
    parser.add_argument("--seed", type=int, default=0, help="of the first start pose")
    parser.add_argument("--video", type=Path, metavar="FILE", help="write a film, .mp4 or .gif, instead of a window")
    parser.add_argument("--camera", choices=sorted(CAMERAS), default="above", help="where it is seen from (above)")
    parser.add_argument("--speed", type=float, default=1.0, help="times as fast as it happens (1)")
    return parser.parse_args(arguments)


@command
def main(arguments: list[str] | None = None) -> None:
    """Play, and say how the episodes went."""
    options = parse(arguments)
    check(options)
    settings = parse_settings(options.set)
    if options.teleop:
        drive_by_keyboard(resolve("random", options.task, settings=settings), options.seed, options.camera)
        return
    if options.agent is not None:
        config = resolve(options.agent, options.task, settings=settings)
        policy: Policy = make_baseline(config)
        name = options.agent.replace(":", ".")
    else:
        policy, name = load(options.policy), film_name(options.policy)
        config = with_task(config_of(policy), task_settings(settings))
    conditions = {"episodes": options.episodes, "seed": options.seed}
    if options.video or not has_display():
        video = options.video or Path(f"{name}.mp4")
        film(
            policy,
            video,
            config,
            steps=options.steps,
            camera=options.camera,
            speed=options.speed,
            tell=True,
            **conditions,
        )
        print(f"wrote {video} ({video.stat().st_size / 1e6:.1f} MB)")
        return
    policy, env = open_world(policy, config, {}, options.steps)
    with closing(env), closing(Window(env.maze, env.task, options.camera)) as window, suppress(KeyboardInterrupt):
        watch(env, drive_all(env, policy, **conditions), window, options.speed)


def film_name(reference: str) -> str:
    """What a film is called after the policy that a reference means."""
    return Path(reference.removeprefix("zoo:")).resolve().name.removesuffix(SUFFIX)


def check(options: argparse.Namespace) -> None:
    """Raise an `InputError` where options do not go together, or do not fit."""
    if [options.policy is not None, options.agent is not None, options.teleop].count(True) != 1:
        raise InputError("name either a policy (a run folder, a checkpoint, zoo:NAME), or an --agent, or --teleop")
    if options.policy and options.task:
        raise InputError("--task goes with --agent and --teleop; a policy keeps the task that it was trained at")
    if options.teleop and options.video:
        raise InputError("--video films a policy; --teleop shows what you drive in the terminal")
    check_numbers(options.episodes, options.steps, options.seed, options.speed)
    if options.video:
        check_film(options.video, options.camera)


def drive_by_keyboard(config: Config, seed: int, camera: str = "above") -> None:
    """Let the user drive, in the terminal, and in the window if there is a display."""
    if not (sys.stdin.isatty() and sys.stdout.isatty()):
        raise InputError("--teleop reads keys from a terminal and draws on it; here stdin or stdout is none")
    with closing(Teleop(config, seed)) as teleop:
        if has_display():
            with closing(Window(teleop.env.maze, teleop.env.task, camera)) as window:
                steer_in_terminal(teleop, window.show)
        else:
            steer_in_terminal(teleop, lambda pose: True)


if __name__ == "__main__":
    main()
