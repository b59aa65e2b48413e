"""Generated terrain: fractal relief, craters and rocks from a few seeded parameters, with statistics of the result."""
