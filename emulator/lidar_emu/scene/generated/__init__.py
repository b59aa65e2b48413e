"""Generated terrain: fractal relief, craters and rocks from a few seeded parameters, and its statistics."""
