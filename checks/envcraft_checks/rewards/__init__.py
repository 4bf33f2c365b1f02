"""What the check ``reward`` reads from a syntax tree: the lines that write the reward, and the one behind a finding."""
