"""A recording in the Rerun viewer."""
