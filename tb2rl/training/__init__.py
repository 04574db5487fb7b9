"""Trainings: from a config to a run folder, with callbacks, diagnostics, trackers and exact resume.

`training.py` is the place to begin.
"""
