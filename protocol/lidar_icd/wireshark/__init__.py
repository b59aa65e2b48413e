"""A dissector for Wireshark."""
