"""What the check ``termination`` reads from traces: time limits, successes, losses, and the steps after an end."""
