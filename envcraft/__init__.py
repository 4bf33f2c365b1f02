"""EnvCraft: validation-first tools for generated Gymnasium environments."""

__version__ = "0.1.0"
