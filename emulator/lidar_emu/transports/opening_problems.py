"""Why a port cannot be opened, and what the user can do about it.

Sources: proc_pid_fd(5), proc_pid_fdinfo(5); tty_show_fdinfo of Linux, which numbers the terminal of a pty's master;
linux/if_arp.h.
"""

from __future__ import annotations

import errno
import os
import re
from contextlib import suppress
from pathlib import Path

from lidar_emu.errors import InputError, one_line
from lidar_emu.transports.spec import PortSpec

_TERMINALS = Path("/dev/pts")
_MASTERS = (Path("/dev/ptmx"), _TERMINALS / "ptmx")
_NAMED_AT_MOST = 3
_LISTED_AT_MOST = 8
_IN_USE = "in use by another program"
_REASONS = {
    errno.ENXIO: "there is no such device",
    errno.EBUSY: _IN_USE,
    errno.EAGAIN: _IN_USE,
    errno.EISDIR: "it is a folder, not a port",
}


def serial_problem(error: Exception, path: str) -> str:
    """What to do about an error at opening a serial port, a pty, a terminal server or another URL of pyserial."""
    if os.strerror(errno.ENOTTY) in str(error):
        return "it is not a serial device"
    number: object = error.args[0] if error.args else None  # termios.error is no OSError
    if number == errno.ENOENT:
        if re.fullmatch(r"v?can\d+", path):
            return f"a CAN bus is not a port; pass -i socketcan -c {path}"
        return f"there is no such port; {_serial_ports()}; a run makes one with --port pty:lidar"
    if number == errno.EACCES:
        group = _group(path)
        return f"permission denied; run: sudo usermod -aG {group} $USER, and log in again"
    reason = next((text for known, text in _REASONS.items() if known == number), one_line(str(error)))
    users = users_of(path) if reason is _IN_USE else ""
    return f"{reason}: {users}" if users else reason


def refuse_used(path: str) -> None:
    """Refuse a serial device or a pty that another program has open: two readers steal each other's bytes.

    Raises:
        InputError: names the other programs.
    """
    if users := users_of(path):
        remedy = f"{_IN_USE}: {users}; end it, or command through the run: send --control PATH"
        raise InputError("--port", None, path, remedy)


def users_of(path: str) -> str:
    """Other processes that have a device open, as far as this user may see them: "cat (process 42)"; empty if none.

    A process that holds the master end of the same pty made the cable, and reads at its other end.
    """
    device, found = Path(path).resolve(), []
    for folder in Path("/proc").glob("[0-9]*/fd"):
        if folder.parent.name == str(os.getpid()):
            continue
        opened: dict[Path, Path] = {}
        with suppress(OSError):
            for link in folder.iterdir():
                with suppress(OSError):  # closed meanwhile
                    opened[link] = link.readlink()
            if device in opened.values() and not _has_master(opened, device):
                name = (folder.parent / "comm").read_text().strip()
                found.append(f"{name} (process {folder.parent.name})")
    return ", ".join(found[:_NAMED_AT_MOST])


def _has_master(opened: dict[Path, Path], device: Path) -> bool:
    masters = [link for link, target in opened.items() if target in _MASTERS and device.parent == _TERMINALS]
    infos = [(link.parents[1] / "fdinfo" / link.name).read_text() for link in masters]
    return any(f"tty-index:\t{device.name}\n" in info for info in infos)


def _serial_ports() -> str:
    from serial.tools.list_ports import comports

    names = sorted(port.device for port in comports())[:_LISTED_AT_MOST]
    return f"serial ports here: {', '.join(names) or 'none'}"


def _group(path: str) -> str:
    """The group that may open a device, `dialout` on Debian and `uucp` on others."""
    with suppress(OSError, KeyError):
        group = Path(path).group()
        return "dialout" if group == "root" else group
    return "dialout"


_CAN_INTERFACE = "280"
_IN_USER_SPACE = "without it, -i udp_multicast -c 239.0.0.1 is a bus in user space"


def can_problem(error: BaseException, spec: PortSpec) -> str | None:
    """What to do about an error at opening a bus; None if its own text says it."""
    number = getattr(error, "errno", None) or getattr(error.__cause__, "errno", None)
    match spec.interface, number:
        case "socketcan", errno.EAFNOSUPPORT | errno.EPROTONOSUPPORT:
            return f"this kernel has no CAN: sudo modprobe -a can_raw vcan; {_IN_USER_SPACE}"
        case "socketcan", errno.ENODEV:
            return f"there is no such interface; {_can_interfaces(spec.channel)}; {_IN_USER_SPACE}"
        case "udp_multicast", errno.ENODEV:
            return (
                f"no route for multicast; on this machine alone: sudo ip route add {spec.channel}/32 dev lo"
            )
    return None


def _can_interfaces(wanted: str) -> str:
    types = {file.parent.name: file.read_text().strip() for file in Path("/sys/class/net").glob("*/type")}
    names = ", ".join(sorted(name for name, kind in types.items() if kind == _CAN_INTERFACE))
    add = f"sudo ip link add {wanted} type vcan && sudo ip link set {wanted} up"
    how = f"add it: {add}" if wanted.startswith("vcan") else "connect its adapter"
    return f"CAN interfaces here: {names or 'none'}; {how}"
