"""One ground of several grids: set into one another, refined below their pixels, painted with their albedo."""
