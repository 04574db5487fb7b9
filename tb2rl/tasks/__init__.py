"""Tasks: actions, initial states, rewards and endings.

A task is one class; copy `my_turtlebot2_maze.py` (see README.md). Imports sensors and what lies below them.
"""

from tb2rl.tasks.actions import Actions, Commands, Velocities
from tb2rl.tasks.task import TIME_LIMIT, Ending, Outcome, Task, collision_endings

__all__ = ["TIME_LIMIT", "Actions", "Commands", "Ending", "Outcome", "Task", "Velocities", "collision_endings"]
