"""Soft actor-critic (Haarnoja et al. 2018) of Stable-Baselines3, for continuous actions."""

from tb2rl import Agent

AGENT = Agent("stable_baselines3:SAC", actions="continuous")
