"""Proximal policy optimisation with a memory (an LSTM), sb3-contrib's."""

from tb2rl import Agent

AGENT = Agent("sb3_contrib:RecurrentPPO")
