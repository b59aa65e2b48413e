"""Internet addresses as users write them."""

from __future__ import annotations

import pytest

from lidar_emu.ip_addresses import Endpoint, endpoint, is_address, is_this_machine


@pytest.mark.parametrize(
    ("text", "host", "port"),
    [
        ("127.0.0.1:5600", "127.0.0.1", 5600),
        ("127.0.0.1", "127.0.0.1", None),
        ("bench:1", "bench", 1),
        ("[::1]:65535", "::1", 65535),
        ("[::1]", "::1", None),
        ("::1", "::1", None),
        ("fe80::1%eth0", "fe80::1%eth0", None),
    ],
)
def test_endpoints(text: str, host: str, port: int | None) -> None:
    assert endpoint(text) == Endpoint(host, port)


@pytest.mark.parametrize("text", ["127.0.0.1:0", "127.0.0.1:65536", "127.0.0.1:-1", "127.0.0.1:port"])
def test_a_port_is_a_number_up_to_65535(text: str) -> None:
    with pytest.raises(ValueError, match=r"port|invalid literal"):
        endpoint(text)
    assert not is_address(text)


def test_names_are_no_addresses() -> None:
    assert [is_address(text) for text in ("10.0.0.1", "[::1]:9", "simulator", "", "10.0.0")] == [
        True,
        True,
        False,
        False,
        False,
    ]


def test_hosts_of_this_machine_alone() -> None:
    assert all(map(is_this_machine, ["localhost", "127.0.0.1", "127.9.9.9", "::1"]))
    assert not any(map(is_this_machine, ["0.0.0.0", "::", "192.168.1.2", "bench", ""]))
