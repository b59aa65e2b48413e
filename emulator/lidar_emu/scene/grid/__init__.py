"""An elevation grid: its surface, and the casting of rays and of bundles of them onto it."""
