"""An elevation grid: its surface, and the casting of rays and bundles of rays onto it."""
