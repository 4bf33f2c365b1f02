"""The version of EnvCraft, apart from the public API so that every layer can import it."""

__version__ = "0.1.0"
