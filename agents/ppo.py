"""Proximal policy optimisation (Schulman et al. 2017), Stable-Baselines3's."""

from tb2rl import Agent

AGENT = Agent("stable_baselines3:PPO")
