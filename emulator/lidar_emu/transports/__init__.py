"""Serial, CAN and in-memory links: whole packets in and out of descriptors, without waiting."""
