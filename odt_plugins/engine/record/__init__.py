"""What a run remembers and tells: figures of a state, best states, progress."""
