"""Writes INTERFACE.md, lidar.dbc and lidar.h beside the interface definition that they are generated from.

python tests/protocol/make_documents.py
"""

from __future__ import annotations

from pathlib import Path

import lidar_icd
import lidar_protocol
from lidar_emu.cli.documents import interface_document
from lidar_emu.scenario.load import load


def main() -> None:
    """Write all files."""
    folder = Path(lidar_protocol.__file__).parent
    interface = lidar_protocol.default_interface()
    document = interface_document(interface, "descent.yaml", load("descent.yaml"))
    (folder / "INTERFACE.md").write_text(document, encoding="utf-8")
    (folder / "lidar.h").write_text(lidar_icd.c_header(interface), encoding="utf-8")
    (folder / "lidar.dbc").write_text(lidar_icd.dbc(interface), encoding="utf-8")


if __name__ == "__main__":
    main()
