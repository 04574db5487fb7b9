"""Work in parts that need not wait for each other, done by processes of this machine or by a Ray cluster.

`running.py` is the place to begin. Imported from here: what all rooms need. Commands and the judge bring the work; what
it is, this room does not know, and it imports nothing that takes long, for a worker sets its threads before that.
"""
