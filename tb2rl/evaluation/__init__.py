"""Evaluation of policies: episodes, metrics, confidence intervals and suites.

Functions return their results; they write no files and print no tables. Imports `deploy` and the packages below it.
"""
