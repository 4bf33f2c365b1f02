"""What makes two environments the same one: four layers, each with a key of its own, and the measure of what is left.

Sources are tokenised and parsed here, never run; how an environment behaves is known from the sandbox only. What a
layer cannot read has no key in it, and is alike to nothing there.
"""
