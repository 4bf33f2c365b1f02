"""The policies of the players, one module for each family. Their texts run in the sandbox, beside the games."""
