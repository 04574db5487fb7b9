"""Evaluate a policy: standard evaluation, suite, or robot with ROS.

    python -m tb2rl.evaluate runs/maze/dqn/NAME
    python -m tb2rl.evaluate --agent wallfollower

The standard evaluation drives the greedy policy for 100 episodes of at most 1 500 control steps. Each episode has a
start pose that training did not draw and its own random stream, so the result does not depend on the number of
processes. It takes half a minute on two processors.

    python -m tb2rl.evaluate runs/navigate/ppo/NAME --suite unseen
    python -m tb2rl.evaluate runs/navigate/ppo/NAME --suite barn PATH
    python -m tb2rl.evaluate runs/navigate/ppo/NAME --suite unseen --on ray

A suite drives each of its worlds once, from the start to the goal. `unseen` has a thousand worlds that nothing else
draws; `barn` has those of the BARN challenge, from a copy of its repository. The same command continues an interrupted
suite. `--on ray` distributes the worlds with Ray, here or on a cluster.

    python -m tb2rl.evaluate runs/maze/dqn/NAME --simulation ros --steps 300

With `--simulation ros` the policy drives a robot with ROS, your own or one in Gazebo. Its distance is by odometry.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from tb2rl.core.errors import ArgumentParser, command
from tb2rl.execution.arguments import add_executor_arguments
from tb2rl.policy_arguments import add_policy_arguments, add_robot_arguments


def parse(arguments: list[str] | None) -> argparse.Namespace:
    """Parse the command line."""
    parser = ArgumentParser(prog="python -m tb2rl.evaluate", description=(__doc__ or "").splitlines()[0])
    add_policy_arguments(parser)
    parser.add_argument("--episodes", type=int, help="number of episodes (default: 100; of a robot with ROS 1)")
    parser.add_argument("--steps", type=int, help="maximum control steps of an episode (default: 1500)")
    parser.add_argument("--seed", type=int, help="seed of the start poses")
    parser.add_argument("--suite", nargs="+", metavar=("NAME", "PATH"), help="drive a suite: unseen, or barn PATH")
    add_executor_arguments(parser)
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the result here, not into the run folder")
    add_robot_arguments(parser)
    return parser.parse_args(arguments)


@command
def main(arguments: list[str] | None = None) -> None:
    """Evaluate a policy, print a table, write JSON."""
    options = parse(arguments)
    if options.suite:  # imported late: they take seconds
        from tb2rl.commands.suite import run
    else:
        from tb2rl.commands.evaluate import run
    run(options)


if __name__ == "__main__":
    main()
