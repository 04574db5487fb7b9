"""Deep Q-network (Mnih et al. 2015), Stable-Baselines3's."""

from tb2rl import Agent

AGENT = Agent("stable_baselines3:DQN", actions="named")
