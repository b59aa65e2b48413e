"""Documents generated from an interface definition: INTERFACE.md, the DBC file, the C header, Wireshark's dissector."""

from lidar_icd.c.header import c_header
from lidar_icd.can_database import dbc
from lidar_icd.markdown.document import interface_markdown
from lidar_icd.wireshark.dissector import dissector

__all__ = ["c_header", "dbc", "dissector", "interface_markdown"]
