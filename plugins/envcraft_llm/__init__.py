"""Generation of environments with language models: concepts, stages, endpoints, and data for fine-tuning."""
