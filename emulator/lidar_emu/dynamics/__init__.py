"""Powered descent: the equations of motion, what commands them, and their integration."""
