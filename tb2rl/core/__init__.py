"""Foundations of every room: errors, values, files, trust, plugins, agents, compiled code, processes, signals.

Imports no other room.
"""
