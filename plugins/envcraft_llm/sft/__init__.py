"""``envcraft export --to sft``: what the pipeline made and judged, as data to fine-tune models on."""
