"""The port process: it owns the descriptor and sends each packet when it is due."""
