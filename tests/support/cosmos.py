"""A generated plugin in the Python library of OpenC3 COSMOS, whose services call the same functions."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any

os.environ["OPENC3_NO_STORE"] = "1"  # messages of the library stay in this process
from openc3.config.config_parser import ConfigParser
from openc3.models.interface_model import InterfaceModel
from openc3.packets.commands import Commands
from openc3.packets.packet_config import PacketConfig
from openc3.packets.telemetry import Telemetry
from openc3.system.target import Target

import lidar_icd
from lidar_protocol.definitions import Interface

TARGET = "LIDAR"
_LIB = f"targets/{TARGET}/lib"


class Stream:
    """A stream that reads portions of bytes and keeps what is written."""

    def __init__(self, portions: Iterable[bytes]) -> None:
        self._portions = list(portions)
        self.taken = 0
        self.written = b""

    def connected(self) -> bool:
        return True

    def disconnect(self) -> None:
        """End nothing."""

    def read(self) -> bytes:
        self.taken += 1
        return self._portions[self.taken - 1] if self.taken <= len(self._portions) else b""

    def write(self, data: bytes) -> None:
        self.written += bytes(data)


class Cosmos:
    """A plugin that was installed with values for its variables."""

    def __init__(self, folder: Path, **variables: object) -> None:
        sys.modules.pop("lidar_frames", None)  # another plugin's
        sys.path[:] = [path for path in sys.path if not path.endswith(_LIB)]
        self.target, config = Target(TARGET, folder / "targets"), PacketConfig()
        for file in self.target.cmd_tlm_files:
            config.process_file(file, TARGET)
        self.warnings = config.warnings
        self.telemetry, self.commands = Telemetry(config, None), Commands(config, None)
        template = (folder / "plugin.txt").read_text()
        values = dict(re.findall(r"^VARIABLE (\w+) (.*)$", template, re.MULTILINE)) | variables
        (folder / "installed.txt").write_text(
            re.sub(r"<%= (\w+) %>", lambda of: str(values[of[1]]), template)
        )
        self._lines = [
            (keyword, words[:]) for keyword, words in ConfigParser().parse_file(folder / "installed.txt")
        ]

    def interface(self, portions: Iterable[bytes] | None = None) -> Any:
        """The interface of the plugin: not connected, or with a stream of portions of bytes."""
        ((name, *parameters),) = (words for keyword, words in self._lines if keyword == "INTERFACE")
        protocols = [words for keyword, words in self._lines if keyword == "PROTOCOL"]
        made = InterfaceModel(name, parameters, protocols=protocols).build()
        if portions is not None:
            made.stream = Stream(portions)
        return made

    def packets(self, portions: Iterable[bytes]) -> list[Any]:
        """Packets that the interface reads from portions of bytes."""
        return list(iter(self.interface(portions).read, None))

    def row(self, packet: Any) -> dict[str, Any]:
        """Values of a packet by our names, words as their numbers; without those that the packet does not hold."""
        defined = self.telemetry.identify_and_define_packet(packet, [TARGET])
        if defined is None:
            return {}
        # COSMOS reports packets of other lengths.
        missing = defined.defined_length - len(defined.buffer)
        assert missing == 0 or (missing > 0 and defined.short_buffer_allowed)
        row: dict[str, Any] = {"packet": defined.packet_name}
        for name, value in defined.read_all("CONVERTED"):
            states = defined.get_item(name).states or {}
            if defined.read(name, "RAW") is not None:
                row[name.lower()] = states.get(value, value)
        return row

    def command(self, name: str, **arguments: object) -> Any:
        """A command, built as for `cmd("LIDAR NAME with ...")`."""
        return self.commands.build_cmd(TARGET, name, {key.upper(): value for key, value in arguments.items()})


def plugin(interface: Interface, folder: Path, unit: int = 0, beams: int | None = None) -> Cosmos:
    """The plugin of an interface, written to a folder."""
    for name, text in lidar_icd.cosmos(interface, unit, beams).items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text, encoding="utf-8")
    return Cosmos(folder)
