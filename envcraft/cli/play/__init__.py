"""A person plays: keys to actions, one episode in the sandbox at a time, and what is shown of it."""
