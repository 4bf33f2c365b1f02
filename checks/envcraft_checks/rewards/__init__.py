"""What the check ``reward`` reads: lines that write the reward from the code, and what earns too much from play."""
