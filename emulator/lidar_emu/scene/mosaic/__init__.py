"""One ground from several grids: nested, refined below their pixels, with their albedo."""
