"""How environments come about: families, generators, and the stages from a concept to an environment."""
