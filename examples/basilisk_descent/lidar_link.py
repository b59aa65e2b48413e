"""The simulation's two sockets: truth to the emulated lidar, commands from the navigator that reads its packets."""

import socket
import sys
import time
from pathlib import Path

from command import Command

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from live_truth import Packet, packets_of, send

Address = tuple[str, int]
_TIMEOUT_S = 60.0


class LidarLink:
    """Sockets of the simulation. In lockstep each process waits for the others. One step is:

    1. truth goes to the emulator;
    2. the emulator writes the packets that are due by then to the port, and then replies with the same packets;
    3. the navigator reads the port and sends one command for each packet;
    4. the step ends when as many commands have arrived as the reply had packets.

    In real time truth is sent without waiting: a command takes effect with the step after its arrival.
    """

    def __init__(self, truth_to: Address, commands_at: Address, lockstep: bool) -> None:
        self._lockstep = lockstep
        self._truth = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._truth.connect(truth_to)
        self._truth.settimeout(1.0)
        self._commands = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._commands.bind(commands_at)
        self._commands.settimeout(_TIMEOUT_S if lockstep else 0.0)

    def exchange(self, datagram: bytes, sequence: int, last: bool) -> list[Command]:
        """Send truth; returns the new commands.

        Raises:
            TimeoutError: the emulator or the navigator does not answer.
        """
        send(self._truth, datagram)
        if not self._lockstep:
            return self._arrived()
        packets = self._answer(datagram, sequence)
        return [] if last else [self._awaited() for _ in packets]

    def _answer(self, datagram: bytes, sequence: int) -> list[Packet]:
        ends_s = time.monotonic() + _TIMEOUT_S
        while (packets := packets_of(self._truth, sequence)) is None:
            if time.monotonic() > ends_s:
                raise TimeoutError("no answer to truth: is `lidar-emu run ... --pace lockstep` running?")
            # The receiver may not be listening yet; a repeated truth has no effect.
            time.sleep(0.05)
            send(self._truth, datagram)
        return packets

    def _awaited(self) -> Command:
        try:
            return Command.from_bytes(self._commands.recv(1024))
        except TimeoutError:
            raise TimeoutError("no command for a packet: does the navigator read the port?") from None

    def _arrived(self) -> list[Command]:
        commands = []
        while True:
            try:
                commands.append(Command.from_bytes(self._commands.recv(1024)))
            except BlockingIOError:
                return commands

    def close(self) -> None:
        """Close the sockets."""
        self._truth.close()
        self._commands.close()
