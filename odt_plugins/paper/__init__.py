"""The paper's own forms and loops, for its reproduction; the engine does without them."""
