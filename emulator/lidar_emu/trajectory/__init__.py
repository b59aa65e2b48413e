"""Where the vehicle is, how it moves and how it is turned, at any instant of a flight."""
