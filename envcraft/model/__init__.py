"""Data that the layers above exchange: contracts, targets, rollouts, traces, verdicts and events."""
