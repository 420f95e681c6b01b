"""What changes a mesh in place: flips, Newton steps, compound moves, insertion."""
