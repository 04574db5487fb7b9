"""Simulators that step all robots in one process; the robots are records of an array for compiled code."""
