"""From mesh to mesh: both stages in turn, the best state, the promise."""
