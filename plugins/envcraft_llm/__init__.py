"""Environments written by language models. So far the first stage: concepts, which need no model."""
