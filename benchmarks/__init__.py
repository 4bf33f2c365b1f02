"""Benchmarks: each figure in the README, measured in one run beside the peer that it is compared with."""
