"""A host in C99: structs, decoder and encoder in one header."""
