"""Interface control documents generated from an interface definition: INTERFACE.md, the DBC file and the C header."""

from lidar_icd.c.header import c_header
from lidar_icd.can_database import dbc
from lidar_icd.markdown.document import interface_markdown

__all__ = ["c_header", "dbc", "interface_markdown"]
