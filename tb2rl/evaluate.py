"""The standard evaluation: how well a policy drives in PyBullet.

    python -m tb2rl.evaluate runs/maze/dqn/NAME
    python -m tb2rl.evaluate --agent wallfollower

The greedy policy drives 100 episodes of at most 1 500 control steps, each with a start pose that training did not draw
and a random stream of its own: the result does not depend on how many processes share the work. It takes half a minute
on two processors.

    python -m tb2rl.evaluate runs/navigate/ppo/NAME --suite unseen
    python -m tb2rl.evaluate runs/navigate/ppo/NAME --suite barn PATH
    python -m tb2rl.evaluate runs/navigate/ppo/NAME --suite unseen --on ray

A suite is driven instead: each of its worlds once, from its start to its goal. `unseen` has a thousand worlds that
nothing else draws, `barn` those of the BARN challenge, from a copy of its repository. What is interrupted goes on where
it was when the same command is given again. With `--on ray` the worlds are shared out by Ray, here or on a cluster.

    python -m tb2rl.evaluate runs/maze/dqn/NAME --simulation ros --steps 300

A robot with ROS is driven instead, your own or one in Gazebo, and counts its way by its odometry.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from tb2rl.core.errors import ArgumentParser, command
from tb2rl.execution.where import add_where
from tb2rl.policy_arguments import add_policy_arguments, add_robot_arguments


def parse(arguments: list[str] | None) -> argparse.Namespace:
    """The command line."""
    parser = ArgumentParser(prog="python -m tb2rl.evaluate", description=(__doc__ or "").splitlines()[0])
    add_policy_arguments(parser)
    parser.add_argument("--episodes", type=int, help="how many (default: 100; of a robot with ROS 1)")
    parser.add_argument("--steps", type=int, help="control steps at most in an episode (default: 1500)")
    parser.add_argument("--seed", type=int, help="of the start poses")
    parser.add_argument("--suite", nargs="+", metavar=("NAME", "PATH"), help="drive a suite: unseen, or barn PATH")
    add_where(parser)
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the result here, not into the run folder")
    add_robot_arguments(parser)
    return parser.parse_args(arguments)


@command
def main(arguments: list[str] | None = None) -> None:
    """Evaluate a policy, print a table, write JSON."""
    options = parse(arguments)
    if options.suite:  # only now: they import what takes seconds
        from tb2rl.commands.suite import run
    else:
        from tb2rl.commands.evaluate import run
    run(options)


if __name__ == "__main__":
    main()
