"""Soft actor-critic (Haarnoja et al. 2018), Stable-Baselines3's; for continuous actions."""

from tb2rl import Agent

AGENT = Agent("stable_baselines3:SAC", actions="continuous")
