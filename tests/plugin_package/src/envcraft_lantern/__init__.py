"""A worked plugin: a check, a contract, a sandbox driver, a reporter, a command, an executor and an export,
one file each."""
