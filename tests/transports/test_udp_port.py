"""UDP: who is heard, who hears, and what is known of somebody who is not there."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from typing import Any

import pytest
from waiting import LIMIT_S

from lidar_emu.errors import InputError
from lidar_emu.transports.link import DeliveryStatus, Link
from lidar_emu.transports.opening import ByteHost, open_host, opener
from lidar_emu.transports.spec import PortSpec, parse_port


def free_port(host: str = "127.0.0.1") -> int:
    with datagram_socket(host) as taken:
        return int(taken.getsockname()[1])


def datagram_socket(host: str = "127.0.0.1", port: int = 0) -> socket.socket:
    bound = socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET, socket.SOCK_DGRAM)
    bound.bind((host, port))
    bound.settimeout(LIMIT_S)
    return bound


@pytest.fixture
def spec() -> PortSpec:
    return parse_port(f"udp:{free_port()}")


@pytest.fixture
def link(spec: PortSpec) -> Iterator[Link]:
    link = Link(opener(spec))
    yield link
    link.close()


@pytest.fixture
def host(spec: PortSpec) -> Iterator[ByteHost]:
    host = open_host(spec)
    assert isinstance(host, ByteHost)
    yield host
    host.close()


def address(spec: PortSpec) -> tuple[str, int]:
    host, _, port = spec.path.rpartition(":")
    return host, int(port)


def test_the_host_opens_by_the_same_name_and_may_be_started_again(
    spec: PortSpec, host: ByteHost, link: Link
) -> None:
    assert host.description == str(spec) == f"udp:127.0.0.1:{address(spec)[1]}"
    assert link.send(b"one", 0) is DeliveryStatus.SENT
    assert host.read(5.0) == b"one"
    host.close()
    assert link.send(b"two", 1) is DeliveryStatus.DROPPED_NOBODY
    again = open_host(spec)
    assert link.send(b"three", 2) is DeliveryStatus.SENT
    assert again.read(5.0) == b"three"
    again.close()
    assert [text for _, text in link.take_events()] == ["nobody connected", "connected"]


def test_an_address_has_one_host(spec: PortSpec, host: ByteHost) -> None:  # noqa: ARG001
    with pytest.raises(InputError, match="Address already in use"):
        open_host(spec)


def test_the_device_hears_nobody_but_its_peer(spec: PortSpec, link: Link) -> None:
    with datagram_socket(*address(spec)) as peer, datagram_socket() as stranger:
        link.send(b"hello", 0)
        _, device = peer.recvfrom(100)
        stranger.sendto(b"a stranger's command", device)
        peer.sendto(b"", device)
        peer.sendto(b"the peer's command", device)
        assert link.receive(0) == b"the peer's command"


def test_nothing_but_loopback_is_reached_unless_it_is_named(link: Link, host: ByteHost) -> None:
    link.send(b"hello", 0)
    for channel in (link._channel, host._channel):
        sock: Any = channel
        assert sock._socket.getsockname()[0] == "127.0.0.1"


def test_a_refusal_that_comes_later_is_seen_without_a_packet(spec: PortSpec) -> None:
    """Across a network it takes a while; here the peer leaves between two looks."""
    link = Link(opener(spec))
    with datagram_socket(*address(spec)):
        assert link.send(b"x", 0) is DeliveryStatus.SENT
    sock: Any = link._channel
    sock._socket.send(b"on its way")
    link.service(1)
    assert [text for _, text in link.take_events()] == ["nobody connected"]
    assert link.receive(2) == b""
    link.close()


def test_what_was_not_read_in_time_is_counted(spec: PortSpec, link: Link) -> None:
    with datagram_socket(*address(spec)) as peer:
        link.send(b"hello", 0)
        _, device = peer.recvfrom(100)
        sock: Any = link._channel
        sock._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1)
        for _ in range(50):
            peer.sendto(b"z" * 100, device)
        received = len(link.receive(0)) // 100
    assert 0 < received < 50
    assert link.counts["lost_frames"] == 50 - received
    assert [text for _, text in link.take_events()] == [
        f"{50 - received} received datagrams lost: they arrived faster than they were read"
    ]


def test_no_way_to_a_network_is_a_broken_link_and_no_end(monkeypatch: pytest.MonkeyPatch, link: Link) -> None:
    def fail(*_: object) -> int:
        raise OSError(101, "Network is unreachable")

    channel: Any = link._channel
    monkeypatch.setattr(channel, "_put", fail)
    assert link.send(b"x", 0) is DeliveryStatus.DROPPED_BROKEN
    link.service(1_000_000_000)
    assert [text for _, text in link.take_events()] == ["link broken: Network is unreachable", "reopened"]


@pytest.mark.parametrize("name", ["nowhere.invalid", "255.255.255.255", "1.2.3.4.5"])
def test_an_address_without_a_way_to_it_is_refused(name: str) -> None:
    with pytest.raises(InputError, match="it cannot be opened") as refused:
        opener(parse_port(f"udp:{name}:5600"))()
    assert refused.value.value == f"udp:{name}:5600"


def test_a_host_of_another_machine_cannot_be_listened_on() -> None:
    with pytest.raises(InputError, match="Cannot assign requested address"):
        open_host(parse_port("udp:192.0.2.1:5600"))
