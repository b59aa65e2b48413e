"""How exact, how fast and how punctual the emulator is, measured by itself."""
