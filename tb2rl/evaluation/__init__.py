"""Evaluation of policies: episodes, metrics, confidence intervals, suites and comparisons of simulators.

Functions return their results; they write no files and print no tables. Imports `deploy` and the packages below it.
"""
