"""A PPS device: the structures of linux/pps.h as C lays them out, and a driver whose answers are faked."""

from __future__ import annotations

import ctypes
import errno
from pathlib import Path
from typing import Any

import pytest

from lidar_emu.errors import InputError
from lidar_emu.transports.pulses import PpsDevice

S = 10**9
AHEAD_NS = 1_764_000_000 * S


class Ktime(ctypes.Structure):
    _fields_ = (("sec", ctypes.c_int64), ("nsec", ctypes.c_int32), ("flags", ctypes.c_uint32))


class Kinfo(ctypes.Structure):
    _fields_ = (
        ("assert_sequence", ctypes.c_uint32),
        ("clear_sequence", ctypes.c_uint32),
        ("assert_tu", Ktime),
        ("clear_tu", Ktime),
        ("current_mode", ctypes.c_int),
    )


class Fdata(ctypes.Structure):
    _fields_ = (("info", Kinfo), ("timeout", Ktime))


class Driver:
    """A driver whose pulses the test gives; `gone` is the error after the device was unplugged."""

    def __init__(self) -> None:
        self.info, self.gone = Kinfo(), False

    def ioctl(self, descriptor: int, request: int, argument: Any = 0, *more: Any) -> Any:  # noqa: ARG002
        # _IOWR('p', 0xa4, struct pps_fdata *): the size is that of a pointer.
        if request != 3 << 30 | 8 << 16 | ord("p") << 8 | 0xA4:
            raise OSError(errno.ENOTTY, "Inappropriate ioctl for device")
        if self.gone:
            raise OSError(errno.ENODEV, "No such device")
        data = Fdata.from_buffer(argument)
        assert (data.timeout.sec, data.timeout.nsec, data.timeout.flags) == (0, 0, 0), "it must not wait"
        data.info = self.info
        return 0


@pytest.fixture
def driver(monkeypatch: pytest.MonkeyPatch) -> Driver:
    driver = Driver()
    monkeypatch.setattr("fcntl.ioctl", driver.ioctl)
    return driver


def test_the_last_rising_edge_is_on_the_monotonic_clock(driver: Driver, tmp_path: Path) -> None:
    (tmp_path / "pps0").touch()
    ahead_ns = AHEAD_NS
    pps = PpsDevice(str(tmp_path / "pps0"), lambda: ahead_ns)
    assert pps.last_ns() is None, "no pulse yet"
    driver.info = Kinfo(
        7, 8, Ktime(1_764_000_012, 345_678_901, 0), Ktime(1_764_000_012, 999_999_999, 0), 0x1011
    )
    assert pps.last_ns() == 12_345_678_901
    ahead_ns += 5 * S  # the system clock was set, and the driver goes by it
    driver.info = Kinfo(8, 8, Ktime(1_764_000_018, 0, 0), Ktime(), 0)
    assert (pps.last_ns(), pps.failure) == (13 * S, None)


def test_a_device_that_goes_away_is_told(driver: Driver, tmp_path: Path) -> None:
    (tmp_path / "pps0").touch()
    pps = PpsDevice(str(tmp_path / "pps0"), lambda: 0)
    driver.gone = True
    assert pps.last_ns() is None
    assert pps.failure == f"no pulses from {tmp_path / 'pps0'}: No such device"


def test_what_is_no_pps_device_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="must be a PPS device that you may read: No such file"):
        PpsDevice(str(tmp_path / "pps0"), lambda: 0)
    with pytest.raises(InputError, match="must be a PPS device that you may read: Inappropriate ioctl"):
        PpsDevice("/dev/null", lambda: 0)
