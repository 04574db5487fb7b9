"""What a training was asked to do, and the folder that keeps everything about it: configs, checkpoints, loading.

Every file name in a run folder stands in `folder.py`, and what others want to keep there they hand over as trees of
plain values and arrays. Imported from here: environments and what lies below them.
"""
