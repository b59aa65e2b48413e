"""Read the report that the LEON3 keeps in memory, where QEMU has no second serial line for it."""

from __future__ import annotations

import json
import socket
from pathlib import Path

REPORT_ADDRESS, REPORT_BYTES = 0x40100000, 4 + (1 << 20)


def saved_report(monitor: Path, file: Path) -> str:
    """Text of the report so far, by way of QEMU's monitor (QMP) and a file."""
    save = {"val": REPORT_ADDRESS, "size": REPORT_BYTES, "filename": str(file)}
    with socket.socket(socket.AF_UNIX) as connection:
        connection.connect(str(monitor))
        answers = connection.makefile("r")
        answers.readline()  # the greeting
        for command in ({"execute": "qmp_capabilities"}, {"execute": "pmemsave", "arguments": save}):
            connection.sendall(json.dumps(command).encode())
            answer = json.loads(answers.readline())
            if "return" not in answer:
                raise RuntimeError(f"QEMU: {answer}")
    memory = file.read_bytes()
    length = int.from_bytes(memory[:4], "big")
    return memory[4 : 4 + length].decode()
