"""Proximal policy optimisation (Schulman et al. 2017) of Stable-Baselines3."""

from tb2rl import Agent

AGENT = Agent("stable_baselines3:PPO")
