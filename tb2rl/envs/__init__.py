"""Scenes, observations, and environments for one robot or thousands.

Only `scene.py`, with its helpers `parts.py` and `worlds.py`, turns the names in a task's settings into objects; all
other code receives objects. Imports tasks and what lies below them.
"""
