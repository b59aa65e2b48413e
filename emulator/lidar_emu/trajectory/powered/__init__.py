"""Powered descent with six degrees of freedom: equations of motion, guidance and control, integration."""
