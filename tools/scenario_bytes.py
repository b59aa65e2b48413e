"""Digests of what every shipped scenario sends and measures: compare them with the pinned ones, or renew these.

    python tools/scenario_bytes.py                  # compare; exit code 1 if a scenario differs
    python tools/scenario_bytes.py descent          # the same for the scenarios whose names contain the word
    python tools/scenario_bytes.py --packets        # without the columns, whose last digits depend on numpy and numba
    python tools/scenario_bytes.py --renew          # after a change that is meant; the changelog says which and why

The bytes of packets are part of the interface. The columns of a measurement are compared as well, since a packet hides
what is below its resolution; another family of processors may change their last digits.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from contextlib import suppress
from hashlib import sha256
from multiprocessing import Pool
from pathlib import Path
from typing import Any

import lidar_emu

PINNED = Path(__file__).parent.parent / "tests" / "golden" / "scenario_bytes.json"
SCENARIOS = Path(__file__).parent.parent / "scenarios"
LEVELS = ("spectral", "geometric")
_LIVE_NS = 20_000_000_000


def cases() -> list[str]:
    """Every shipped scenario at every level that is pinned, such as `descent spectral`; a bench pattern has none."""
    names = sorted(path.stem for path in SCENARIOS.glob("*.yaml"))
    return [
        case
        for name in names
        for case in ([name] if name == "bench" else [f"{name} {level}" for level in LEVELS])
    ]


def digests(case: str) -> dict[str, Any]:
    """Digests of the packets and of the columns of one case, and how many packets there are."""
    name, _, level = case.partition(" ")
    changes: dict[str, Any] = {"level": level} if level else {}
    if level == "geometric":
        changes["faults"] = []  # Some act in the light, which this level has none of.
    device = lidar_emu.EmbeddedDevice(name, changes)
    packets, columns, count = sha256(), sha256(), 0
    for packet in _sent(device):
        packets.update(packet.payload)
        count += 1
        if packet.measurement is not None:
            for key, column in sorted(packet.measurement.table().items()):
                columns.update(key.encode() + column.tobytes())
    return {"packets": count, "bytes": packets.hexdigest()[:16], "columns": columns.hexdigest()[:16]}


def _sent(device: lidar_emu.EmbeddedDevice) -> Iterator[Any]:
    is_live = device.scenario.live is not None
    while (now_ns := device.next_ns) is not None and not (is_live and now_ns > _LIVE_NS):
        if is_live:
            _give_truth(device, now_ns)
        yield from device.advance(now_ns)


def _give_truth(device: lidar_emu.EmbeddedDevice, now_ns: int) -> None:
    """A vertical descent at 20 m/s in level attitude, for the scenario whose truth comes from outside."""
    position_m, velocity_mps = (0.0, 0.0, 1000.0 - 20.0 * now_ns * 1e-9), (0.0, 0.0, -20.0)
    with suppress(lidar_emu.InputError):  # Two packets of one instant need one truth.
        device.set_truth(now_ns, position_m, velocity_mps, (0.0, 0.7071067811865476, 0.7071067811865476, 0.0))


def main() -> int:
    """Compare, or renew; print what differs."""
    words = [word for word in sys.argv[1:] if not word.startswith("--")]
    chosen = [case for case in cases() if all(word in case for word in words)]
    with Pool() as pool:
        found = dict(zip(chosen, pool.imap(digests, chosen), strict=True))
    pinned = json.loads(PINNED.read_text()) if PINNED.exists() else {}
    compared = ("packets", "bytes") if "--packets" in sys.argv else ("packets", "bytes", "columns")
    differing = [
        case for case in chosen if any(found[case][key] != pinned.get(case, {}).get(key) for key in compared)
    ]
    for case in differing:
        print(f"{case}: {found[case]}, pinned: {pinned.get(case)}")
    if "--renew" in sys.argv:
        kept = {case: pinned[case] for case in cases() if case in pinned} | found
        PINNED.write_text(json.dumps(kept, indent=1, sort_keys=True) + "\n")
        return 0
    print(f"{len(chosen) - len(differing)} of {len(chosen)} as pinned")
    return 1 if differing else 0


if __name__ == "__main__":
    sys.exit(main())
