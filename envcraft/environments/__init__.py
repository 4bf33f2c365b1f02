"""Environments that have been validated, for use by agents: one, many side by side, or by Gymnasium's ids."""
