"""Interface control documents generated from an interface definition: INTERFACE.md, the DBC file and the C header."""
