"""Files and live views of a recording for Rerun, Foxglove and the viewers of ROS 2."""
