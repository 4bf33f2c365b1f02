"""The command line: one group whose commands come from plugins, their options, and what they print."""
