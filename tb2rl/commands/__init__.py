"""What the commands do once their arguments are parsed: each has a module of the same name in `tb2rl/`, and one here.

The ones in `tb2rl/` import nothing heavy, so that `--help` and the list of commands are there at once. A command calls
functions and prints. Imported from here: everything below the commands.
"""
