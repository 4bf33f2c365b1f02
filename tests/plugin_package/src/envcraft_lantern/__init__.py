"""A worked plugin for EnvCraft: a check, a contract, a sandbox driver, a reporter and a command, one file each."""
