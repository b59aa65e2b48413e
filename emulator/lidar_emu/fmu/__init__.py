"""An emulated lidar as a unit of co-simulation (FMU) by the standard FMI, versions 2.0 and 3.0."""
