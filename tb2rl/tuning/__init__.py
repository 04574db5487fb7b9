"""Hyperparameter search with Optuna: trials of settings, selection of the best ones in PyBullet, and a page.

`study.py` is the place to begin. This room imports training and what lies below it. Only the command `tune` imports
this room, because it needs Optuna, the extra `tune`.
"""
