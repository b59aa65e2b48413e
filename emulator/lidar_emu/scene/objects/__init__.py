"""Objects on the ground: shapes, positions and motion."""
