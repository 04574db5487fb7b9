"""Hyperparameter search with Optuna: trials of settings, selection of the best trial in physics, and a report page.

Read `study.py` first. This room imports training and the rooms below it. Only the command `tune` imports this room,
because it needs Optuna (the extra `tune`).
"""
