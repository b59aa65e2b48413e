"""Plan of a run: stages computed and left out, with error bounds; expected errors and detection forecast."""
