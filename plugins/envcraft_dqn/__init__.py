"""Training and evaluation of DQN agents, the learnability check, and studies of generalisation."""
