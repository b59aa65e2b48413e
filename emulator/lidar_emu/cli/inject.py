"""`lidar-emu inject`: inject a fault in flight."""

from __future__ import annotations

import json
import socket
import tempfile
from pathlib import Path
from typing import Any

import click

from lidar_emu.cli.terminal import print_line
from lidar_emu.errors import Finding, InputError, RunError

_TIMEOUT_S = 5.0
_LONGEST_BYTES = 65536


@click.command(short_help="Inject a fault into a run started with --control PATH.")
@click.argument("path")
@click.argument("fault", nargs=-1, required=True)
@click.option("--json", "as_json", is_flag=True, help="Print the reply as JSON.")
def inject(path: str, fault: tuple[str, ...], as_json: bool) -> int:
    """Inject FAULT into the run that was started with --control PATH.

    FAULT is a mapping as in a scenario, or keys and values. Its times count from the first shot that it can still
    affect; lasts_s without a probability is its duration.

    \b
    lidar-emu inject /tmp/lidar.sock '{kind: dropout, beams: [2], lasts_s: 2}'
    lidar-emu inject /tmp/lidar.sock kind=bias range_m=3 ramp_s=5
    """
    reply = request(path, _mapping(fault))
    if as_json:
        print_line(json.dumps(reply))
    elif reply["accepted"]:
        print_line(f"accepted: fault {reply['fault']}, {reply['kind']}")
    else:
        raise RunError(f"rejected: {reply['reason']}")
    return 0 if reply["accepted"] else 1


def _mapping(words: tuple[str, ...]) -> str:
    if all("=" in word and not word.lstrip().startswith("{") for word in words):
        return "{" + ", ".join(": ".join(word.split("=", 1)) for word in words) + "}"
    return " ".join(words)


def request(path: str, fault: str) -> dict[str, Any]:
    """Inject a fault, in YAML, through the socket at `path`; return the reply.

    Raises:
        RunError: there was no reply.
        InputError: `path` is not the socket of a run.
    """
    if not hasattr(socket, "AF_UNIX"):
        raise InputError("inject", None, Finding("no Unix sockets on this system"), "use Linux")
    with (
        tempfile.TemporaryDirectory(prefix="lidar-emu-") as folder,
        socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as requester,
    ):
        requester.bind(str(Path(folder) / "reply"))
        requester.settimeout(_TIMEOUT_S)
        try:
            requester.sendto(fault.encode(), path)
            reply: dict[str, Any] = json.loads(requester.recv(_LONGEST_BYTES))
        except TimeoutError:
            raise RunError(f"{path}: no reply within {_TIMEOUT_S:g} s") from None
        except OSError as error:
            found = Finding(f"{path}: {error.strerror or error}")
            raise InputError("PATH", None, found, "name the path of a run's --control") from None
    return reply
