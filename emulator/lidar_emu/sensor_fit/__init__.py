"""A sensor characterised from a log of its flight, and held against the part of the log that was not used."""
