"""How exact and how fast the emulator is, measured by itself."""
