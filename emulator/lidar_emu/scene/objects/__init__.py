"""Objects on the ground: their shapes, their places and how they move."""
