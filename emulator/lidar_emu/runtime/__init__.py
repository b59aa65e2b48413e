"""A run in real time: the port process, the feeds of shots, and the device's side of the link."""
