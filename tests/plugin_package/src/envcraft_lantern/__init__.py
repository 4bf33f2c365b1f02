"""A worked plugin for EnvCraft: a check, a contract, a reporter and a command, one file each."""
