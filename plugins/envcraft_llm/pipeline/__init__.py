"""The pipeline: commands, stage context, judging, the runner of the stages, progress and result tables."""
