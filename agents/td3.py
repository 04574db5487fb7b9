"""Twin delayed deep deterministic policy gradient (Fujimoto et al. 2018), Stable-Baselines3's; continuous actions."""

from tb2rl import Agent

AGENT = Agent("stable_baselines3:TD3", actions="continuous")
