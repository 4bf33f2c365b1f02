"""A worked plugin: a check, a contract, a sandbox driver, a reporter, a command and an executor, one file each."""
