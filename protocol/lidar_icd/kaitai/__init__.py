"""A specification for the compiler of Kaitai Struct."""
