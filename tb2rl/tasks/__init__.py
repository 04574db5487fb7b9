"""Tasks: actions, initial states, rewards and endings.

A task is one class; copy `my_turtlebot2_maze.py` (see README.md). Imports the rooms below: sensors, simulation, ...
"""

from tb2rl.tasks.actions import Actions, Commands, Velocities
from tb2rl.tasks.outcome import TIME_LIMIT, Ending, Outcome, collision_endings
from tb2rl.tasks.task import Task

__all__ = ["TIME_LIMIT", "Actions", "Commands", "Ending", "Outcome", "Task", "Velocities", "collision_endings"]
