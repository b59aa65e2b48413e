"""The instrument as a device: modes, commands, clock and temperature, as functions of scenario time."""
