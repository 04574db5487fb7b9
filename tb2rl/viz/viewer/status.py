"""Texts of the viewer's page: what the robot does, where it is to go, what it sees, and what its policy computes."""

import html
import math

import numpy as np

from tb2rl.envs.scene import Scene
from tb2rl.rendering.colours import GOAL, PATH
from tb2rl.simulation import RobotState
from tb2rl.viz.cameras import goal_of
from tb2rl.viz.viewer.drive import Drive
from tb2rl.viz.viewer.policy_values import ACTION_VALUES, PolicyValues, policy_values

_MAX_NUMBERS = 12  # numbers of an observation that are shown
_EXPECTED = "Expected sum of the rewards to come, later ones discounted"
_STILL = 0.03  # [m/s] or [rad/s] below which the robot does not move


def status(drive: Drive) -> str:
    """What the robot does, where it is to go, and what it sees, as Markdown."""
    step, scene = drive.step, drive.scene
    v, w = step.after.twist[0].tolist()
    paused = " (paused)" if drive.is_paused else ""
    driver = "you" if drive.is_manual else drive.selection.label
    doing = f"the episode ended: {step.info['ended']}" if step.info["ended"] else _motion(v, w)
    endings = ", ".join(f"{reason} {count}" for reason, count in drive.endings.most_common()) or "none has ended"
    lines = [
        f"**Driver:** {driver}",
        f"**Doing:** {doing}{paused}; {v:z.2f} m/s, {w:+z.2f} rad/s",
        f"**Goal:** {_goal_text(step.after, scene)}",
        f"**Sees:** {_nearest_text(step.after, scene)} (orange beams)",
        f"**Reward** {step.reward:+.3g}, **return so far** {step.episode_return:.4g}",
        f"**Time** {drive.frame.time:.1f} s; **episodes so far:** {endings}",
        f"**World:** {drive.episode_world.name}; task {drive.selection.config.task_name}, robot {scene.robot.name}, "
        f"{drive.selection.simulator.title}",
    ]
    return "\n\n".join(lines)


def _motion(v: float, w: float) -> str:
    """A forward speed [m/s] and a turn rate [rad/s] in words."""
    side = "" if abs(w) < _STILL else " to the left" if w > 0 else " to the right"
    if abs(v) < _STILL:
        return f"turning on the spot{side}" if side else "standing still"
    return ("driving forward" if v > 0 else "driving backward") + (side and f", turning{side}")


def _goal_text(state: RobotState, scene: Scene) -> str:
    goal, (x, y, yaw) = goal_of(scene.task, state.initial_state), state.pose[0].tolist()
    if not np.isfinite(goal).all():
        return "none; this task is to drive on without a collision (tasks with a goal: navigate)"
    angle = math.remainder(math.atan2(goal[1] - y, goal[0] - x) - yaw, math.tau)
    return f"{math.hypot(goal[0] - x, goal[1] - y):.1f} m away, {_side(angle)} (green disc)"


def _nearest_text(state: RobotState, scene: Scene) -> str:
    ranges = state.ranges[0]
    if not np.isfinite(ranges).any():
        return "nothing in range"
    nearest = int(np.argmin(ranges))
    return f"nearest obstacle {ranges[nearest]:.2f} m, {_side(scene.laser.angles[nearest])}"


def _side(angle: float) -> str:
    """A direction in the robot's frame [rad] in words."""
    names = ("ahead", "ahead on the left", "on the left", "behind on the left", "behind")
    name = names[round(abs(angle) / (math.pi / 4))]
    return name if angle >= 0 else name.replace("left", "right")


def values(drive: Drive) -> str:
    """The numbers from which the policy chooses, as bars in HTML."""
    if drive.is_manual:
        return "<p style='padding:0 1em'>You drive, so no policy computes anything.</p>"
    found = policy_values(drive.policy, drive.observation, drive.scene.actions)
    if found is None:
        return "<p style='padding:0 1em'>This policy computes no values for its actions.</p>"
    rows = "".join(
        _bar(f"{name}, chosen", score, *_extent(found, name), GOAL)
        if found.is_chosen(name)
        else _bar(name, score, *_extent(found, name), PATH)
        for name, score in found.scores.items()
    )
    value = f"<p>{_EXPECTED}: <b>{found.value:.3g}</b></p>"
    # It is the largest action value, or NaN because a critic observes privileged sensors.
    if found.meaning == ACTION_VALUES or math.isnan(found.value):
        value = ""
    text, observation = html.escape(found.meaning[0].upper() + found.meaning[1:]), _describe(drive)
    return f"<div style='padding:0 1em'><p>{text}</p>{rows}{value}<p>{observation}</p></div>"


def _extent(found: PolicyValues, name: str) -> tuple[float, float]:
    """Where the bar of a score starts and ends, from 0 to 1: at the middle for a signed one."""
    low, high = found.limits[name]
    zero, end = (np.clip((value - low) / max(high - low, 1e-9), 0.0, 1.0) for value in (0.0, found.scores[name]))
    return float(min(zero, end)), float(max(zero, end))


def _bar(name: str, score: float, start: float, end: float, colour: str) -> str:
    label = f"<span>{html.escape(name)}</span><span>{score:.4g}</span>"
    style = f"margin-left:{100 * start:.0f}%;width:{100 * (end - start):.0f}%;height:0.6em;background:{colour}"
    return f"<div style='display:flex;justify-content:space-between'>{label}</div><div style='{style}'></div>"


def _describe(drive: Drive) -> str:
    observation, scene = drive.observation, drive.scene
    if isinstance(observation, dict):
        shown = ", ".join(f"{html.escape(key)} {np.shape(value)}" for key, value in observation.items())
        return f"Observation: {shown}"
    kind = "classes, 0 the nearest" if scene.observation == "discrete" else "numbers"
    names = ", ".join(f"{sensor.name} {sensor.shape[0]}" for sensor in scene.sensors)
    numbers = np.ravel(observation)
    shown = " ".join(f"{number:.2f}".removesuffix(".00") for number in numbers[:_MAX_NUMBERS])
    more = " ..." if numbers.size > _MAX_NUMBERS else ""
    return f"Observation ({kind}; {html.escape(names)}; beams from right to left): {shown}{more}"
