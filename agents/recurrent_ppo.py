"""Proximal policy optimisation with an LSTM, of sb3-contrib."""

from tb2rl import Agent

AGENT = Agent("sb3_contrib:RecurrentPPO")
