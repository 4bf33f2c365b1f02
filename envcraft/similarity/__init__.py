"""Similarity of environments: four layers, each with its own key.

Sources are tokenised and parsed here, never run. The behaviour of an environment comes from the sandbox. An environment
that a layer cannot read has no key there, and is similar to no other.
"""
