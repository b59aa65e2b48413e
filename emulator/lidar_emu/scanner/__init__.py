"""Where the beams point, when that changes, and how a beam's footprint is sampled."""
