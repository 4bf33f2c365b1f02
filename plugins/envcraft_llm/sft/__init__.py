"""``envcraft export --to sft``: the pipeline's output and its verdicts as data for fine-tuning."""
