"""The ground station of examples/yamcs, and what Yamcs says over HTTP."""

from __future__ import annotations

import importlib.util
import json
import subprocess
import sys
import urllib.error
import urllib.request
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from waiting import LIMIT_S, eventually

PROGRAM = Path(__file__).parents[2] / "examples" / "yamcs" / "ground_station.py"
IS_INSTALLED = importlib.util.find_spec("fprime_yamcs_bundle") is not None


class Yamcs:
    """Yamcs at a port of this machine."""

    def __init__(self, http_port: int) -> None:
        self._url = f"http://127.0.0.1:{http_port}/api"

    def ask(self, path: str, body: dict[str, Any] | None = None) -> str:
        """Answer to GET, or to POST with a body."""
        data = None if body is None else json.dumps(body).encode()
        with urllib.request.urlopen(f"{self._url}/{path}", data, timeout=LIMIT_S) as answer:
            text: str = answer.read().decode()
        return text

    def has_started(self) -> bool:
        try:
            links = json.loads(self.ask("links/lidar"))["links"]
        except (urllib.error.URLError, ConnectionError):
            return False
        return {link["status"] for link in links} == {"OK"}

    def packets(self) -> int:
        """Number of packets that it has received."""
        (link,) = (
            each for each in json.loads(self.ask("links/lidar"))["links"] if each["name"] == "telemetry"
        )
        return int(link["dataInCount"])

    def archived(self, names: Sequence[str]) -> list[dict[str, dict[str, Any]]]:
        """For each packet that has them, the parameters as Yamcs computes them from the archived packets."""
        ids = [{"name": f"/lidar_emu/{name}"} for name in names]
        text, decoder, found = (
            self.ask("stream-archive/lidar:streamParameterValues", {"ids": ids}),
            json.JSONDecoder(),
            [],
        )
        while text := text.lstrip():
            part, end = decoder.raw_decode(text)
            found.append({each["id"]["name"]: each for each in part["parameter"]})
            text = text[end:]
        return found

    def send(self, command: str, **arguments: object) -> None:
        """Send a command to the lidar."""
        self.ask(f"processors/lidar/realtime/commands/lidar_emu/{command}", {"args": arguments})

    def latest(self, name: str) -> Any:
        """Latest value of a parameter; None before the first."""
        parameter = json.loads(self.ask(f"processors/lidar/realtime/parameters/lidar_emu/{name}"))
        return value_of(parameter) if "engValue" in parameter else None


def value_of(parameter: dict[str, Any]) -> Any:
    """A value in its unit; None for NaN."""
    kind = parameter["engValue"]["type"]
    if kind == "ENUMERATED":
        return parameter["engValue"]["stringValue"]
    (value,) = (item for key, item in parameter["engValue"].items() if key != "type")
    return None if value == "NaN" else value if kind == "BOOLEAN" else float(value)


def raw_of(parameter: dict[str, Any]) -> int:
    """A value as sent."""
    (value,) = (item for key, item in parameter["rawValue"].items() if key != "type")
    return int(value)


@contextmanager
def ground_station(device_port: int, http_port: int, folder: Path, *options: str) -> Iterator[Yamcs]:
    """The ground station of the example, from its start to its orderly end."""
    command = [sys.executable, str(PROGRAM), f"127.0.0.1:{device_port}", "--http-port", str(http_port)]
    with subprocess.Popen([*command, "--folder", str(folder), *options]) as program:
        yamcs = Yamcs(http_port)
        try:
            eventually(lambda: program.poll() is not None or yamcs.has_started())
            yield yamcs
        finally:
            program.terminate()
    assert program.returncode == 0
