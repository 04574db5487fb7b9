"""Implementations of the commands.

`tb2rl/NAME.py` defines the arguments of a command, and imports nothing slow, so that `--help` responds at once.
`tb2rl/commands/NAME.py` has the function `run`, which receives the parsed arguments.
"""
