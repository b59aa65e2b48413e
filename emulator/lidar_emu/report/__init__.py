"""Results of a run as tables, point clouds, plots and an HTML report."""
