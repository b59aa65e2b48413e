"""What kernels know of a grid besides its samples, in one array: the place of each number in it."""

WEST_M, SOUTH_M, CELLS_PER_M_EAST, CELLS_PER_M_NORTH, CEILING_M, FLOOR_M, RADIUS_M, COUNT = range(8)
"""Its south-west sample, its scale, bounds of its heights and of those of what fills its holes, and the radius of the
sphere beyond."""
