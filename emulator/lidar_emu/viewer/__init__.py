"""A recording for viewers in three dimensions: Rerun and Foxglove."""
