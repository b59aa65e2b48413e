"""An emulated lidar as a unit of co-simulation (FMU) by the standard FMI 2.0."""
