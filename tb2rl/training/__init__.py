"""How an agent learns: a training from a config to a run folder, what happens beside it, and how it goes on.

`training.py` is the place to begin. Imported from here: showing (for the pictures of paths), judging, runs and what
lies below them.
"""
