"""Evaluations of a policy that drives a robot with ROS: by its odometry and its laser, for there is no other truth."""

from __future__ import annotations

from contextlib import closing
from dataclasses import replace

from tb2rl.deploy.ros.robot import RosRobot, ros_robot
from tb2rl.envs.scene import Scene
from tb2rl.evaluation.evaluation import Evaluation, episode_of
from tb2rl.evaluation.progress import progress as progress_bar
from tb2rl.evaluation.rollout import Policy, roll_out
from tb2rl.simulation import ROS


def evaluate_on_robot(
    policy: Policy,
    scene: Scene,
    robot: RosRobot | str,
    steps: int,
    seed: int,
    episodes: int = 1,
    progress: bool = False,
) -> Evaluation:
    """Drive episodes one after the other; `closest` is by the laser.

    Args:
        policy: What drives.
        scene: At which task; what becomes of its world says `tb2rl.deploy.ros.robot`.
        robot: Where; "ros": a TurtleBot2 with ROS 1.
        steps: Control steps at most in an episode.
        seed: Of a policy that draws.
        episodes: How many.
        progress: Whether to draw a bar, where there is a terminal.

    Raises:
        InputError: If the robot is not there or cannot do it, or what it senses is missing for half a second.
    """
    driven = []
    with closing(ros_robot(robot).env(scene.changed(episode_steps=steps))) as env:
        for number in progress_bar(range(episodes), "evaluating", "episode", shown=progress):
            moments = list(roll_out(env, policy, seed + number))
            closest = min(moment.info["min_range"] for moment in moments) - env.scene.robot.radius
            driven.append(replace(episode_of(env.scene, moments), closest=max(closest, 0.0)))
        return Evaluation(driven, env.scene, seed, ROS)
