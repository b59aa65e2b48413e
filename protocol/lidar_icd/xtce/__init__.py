"""The interface as an XTCE database."""
