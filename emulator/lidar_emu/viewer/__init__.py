"""A recording, also one that is being written, for viewers in three dimensions: Rerun, Foxglove, and those of ROS 2."""
