"""The built-in checks: one rule family, one file, one plugin. Each module's docstring is the rule's page."""
