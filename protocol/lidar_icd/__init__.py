"""Files generated from an interface definition: INTERFACE.md, DBC, C header, Wireshark's dissector, XTCE, COSMOS."""

from lidar_icd.c.header import c_header
from lidar_icd.can_database import dbc
from lidar_icd.cosmos import cosmos
from lidar_icd.device_text import DocumentedDevice
from lidar_icd.document import BeamAxis, ScannerBeams, interface_markdown
from lidar_icd.wireshark import dissector
from lidar_icd.xtce.document import has_xtce, xtce

__all__ = [
    "BeamAxis",
    "DocumentedDevice",
    "ScannerBeams",
    "c_header",
    "cosmos",
    "dbc",
    "dissector",
    "has_xtce",
    "interface_markdown",
    "xtce",
]
