"""What the user writes: the schema of scenarios and their loading."""
