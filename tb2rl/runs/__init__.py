"""Runs: configs, run folders, checkpoints, loading of policies.

`folder.py` has every file name of a run folder; other rooms hand over plain values and arrays. Imports environments and
the rooms below.
"""
