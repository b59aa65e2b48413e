"""Ground from a few seeded parameters: fractal relief, craters and rocks; its statistics; and where it is kept."""
