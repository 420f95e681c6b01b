"""One simplex: its measures, their derivatives, and arrays of them."""
