"""A recording for viewers in three dimensions: Rerun, Foxglove, and those of ROS 2."""
