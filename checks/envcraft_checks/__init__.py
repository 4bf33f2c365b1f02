"""The built-in checks: one check, one file, one plugin. Each module's docstring is the check's page."""
