"""Evaluate a policy: standard evaluation, suite, or robot with ROS.

    python -m tb2rl.evaluate runs/maze/dqn/NAME
    python -m tb2rl.evaluate --agent wallfollower

The standard evaluation has 100 episodes of the greedy policy, of at most 1 500 control steps. Their random start poses
differ from those of trainings. The result does not depend on the number of processes, because each episode has a random
generator of its own. The evaluation takes half a minute on two processors.

    python -m tb2rl.evaluate runs/maze/dqn/NAME --simulation all

`all` drives the same episodes in every physics simulator that is installed, and shows the results side by side with
their sim-to-sim difference. It works with `--suite`, too.

    python -m tb2rl.evaluate runs/navigate/ppo/NAME --suite unseen
    python -m tb2rl.evaluate runs/navigate/ppo/NAME --suite barn PATH
    python -m tb2rl.evaluate runs/navigate/ppo/NAME --suite unseen --on ray

A suite is a fixed set of worlds; the policy drives once in each, from the start to the goal. `unseen` has a thousand
worlds that are used for nothing else, `unknown` 300 floors of 20 to 40 m for robots without a map. `barn` has the
worlds of the BARN challenge; PATH is a copy of its repository. The same command continues an interrupted suite.
`--on ray` distributes the worlds with Ray, here or on a cluster.

    python -m tb2rl.evaluate runs/maze/dqn/NAME --simulation ros --steps 300

With `--simulation ros` the policy drives a robot with ROS, a real one or one in Gazebo. Distances are from odometry.
"""

from pathlib import Path

from tb2rl.commands.arguments import add_policy_arguments, add_robot_arguments
from tb2rl.core.command import ArgumentParser, between, command
from tb2rl.execution.arguments import add_executor_arguments


@command("evaluate", uses_workers=True)
def main(parser: ArgumentParser) -> None:
    """Evaluate a policy, print a table, write JSON."""
    add = parser.add_argument
    add_policy_arguments(parser)
    add("--episodes", type=between(1, 100_000), help="number of episodes (default: 100; with --simulation ros: 1)")
    add("--steps", type=between(1, 2**31 - 1), help="maximum control steps of an episode (default: 1500)")
    add("--seed", type=between(0, 2**32 - 1), help="seed of the start poses")
    add("--suite", nargs="+", metavar=("NAME", "PATH"), help="evaluate in a suite: unseen, unknown, or barn PATH")
    add_executor_arguments(parser)
    add("--json", type=Path, metavar="FILE", help="write the result to this file, not to the run folder")
    add_robot_arguments(parser, "all (every physics simulator), ")


if __name__ == "__main__":
    main()
