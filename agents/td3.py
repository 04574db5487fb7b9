"""Twin delayed deep deterministic policy gradient (Fujimoto et al. 2018) of Stable-Baselines3."""

from tb2rl import Agent

AGENT = Agent("stable_baselines3:TD3", actions="continuous")
