"""A recording, also while it is being written, for viewers in three dimensions: Rerun, Foxglove and those of ROS 2."""
