"""What every room needs: errors, values, files, trust, compiled code, processes and signals.

Imports no other room.
"""
