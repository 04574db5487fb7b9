"""Deep Q-network (Mnih et al. 2015) of Stable-Baselines3."""

from tb2rl import Agent

AGENT = Agent("stable_baselines3:DQN", actions="discrete")
