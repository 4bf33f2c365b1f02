"""What runs the stages: the queue of concepts, the workbench, the judging beside it, and the tables at the end."""
