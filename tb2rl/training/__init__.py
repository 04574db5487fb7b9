"""Trainings: from a config to a run folder, with callbacks, diagnostics, trackers and exact resume.

Read `training.py` first.
"""
