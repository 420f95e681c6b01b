"""What is told about a run: figures before and after, what binds, pictures."""
