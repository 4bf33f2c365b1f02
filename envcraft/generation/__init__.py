"""Generation of environments: families, generators, and the stages from a concept to an environment."""
