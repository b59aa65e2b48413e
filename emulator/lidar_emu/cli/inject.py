"""`lidar-emu inject`: order a fault in flight."""

from __future__ import annotations

import json
import socket
import tempfile
from pathlib import Path
from typing import Any

import click

from lidar_emu.cli.output import say
from lidar_emu.errors import InputError, RunError

_PATIENCE_S = 5.0
_LONGEST_BYTES = 65536


@click.command(short_help="Order a fault in a run that has --control PATH.")
@click.argument("path")
@click.argument("fault", nargs=-1, required=True)
@click.option("--json", "as_json", is_flag=True, help="Print the answer as JSON.")
def inject(path: str, fault: tuple[str, ...], as_json: bool) -> int:
    """Order FAULT in the run that was started with --control PATH.

    FAULT is a mapping as in a scenario, or keys and values. Its times count from the first shot that can still
    have it; lasts_s without a probability is how long it lasts.

    \b
    lidar-emu inject /tmp/lidar.sock '{kind: dropout, beams: [2], lasts_s: 2}'
    lidar-emu inject /tmp/lidar.sock kind=bias range_m=3 ramp_s=5
    """
    answer = _asked(path, _order(fault))
    if as_json:
        say(json.dumps(answer))
    elif answer["accepted"]:
        say(f"accepted: fault {answer['fault']}, {answer['kind']}")
    else:
        raise RunError(f"refused: {answer['reason']}")
    return 0 if answer["accepted"] else 1


def _order(words: tuple[str, ...]) -> str:
    if all("=" in word and not word.lstrip().startswith("{") for word in words):
        return "{" + ", ".join(": ".join(word.split("=", 1)) for word in words) + "}"
    return " ".join(words)


def _asked(path: str, order: str) -> dict[str, Any]:
    with (
        tempfile.TemporaryDirectory(prefix="lidar-emu-") as folder,
        socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as asking,
    ):
        asking.bind(str(Path(folder) / "answer"))
        asking.settimeout(_PATIENCE_S)
        try:
            asking.sendto(order.encode(), path)
            answer: dict[str, Any] = json.loads(asking.recv(_LONGEST_BYTES))
        except TimeoutError:
            raise RunError(f"{path}: no answer within {_PATIENCE_S:g} s") from None
        except OSError as error:
            allowed = f"{error.strerror or error}; allowed: the path of a run's --control"
            raise InputError("PATH", None, path, allowed) from None
    return answer
