"""The input surface under a surface that moves, and the guards of every move."""
