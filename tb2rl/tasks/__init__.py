"""What is asked: the actions there are, where an episode begins, what a step was worth, and when it is over.

A task is one class (see README.md); `my_turtlebot2_maze.py` is the one to copy. Imported from here: sensors, the
simulation and what lies below it.
"""

from tb2rl.tasks.actions import Actions, Commands, Velocities
from tb2rl.tasks.outcome import TIME_LIMIT, Ending, Outcome, collision_endings
from tb2rl.tasks.task import Task

__all__ = ["TIME_LIMIT", "Actions", "Commands", "Ending", "Outcome", "Task", "Velocities", "collision_endings"]
