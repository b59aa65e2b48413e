"""An emulated lidar in a process of its own, for tests of flight software."""
