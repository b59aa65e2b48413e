"""A recording, also one being written, for viewers in three dimensions: Rerun, Foxglove and the viewers of ROS 2."""
