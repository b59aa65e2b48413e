"""Position, motion and attitude of the vehicle at any instant of a flight."""
