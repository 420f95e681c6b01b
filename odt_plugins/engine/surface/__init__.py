"""ODT on curved triangle meshes: vertices slide on the input surface, within an envelope."""
