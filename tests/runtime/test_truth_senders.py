"""Which simulators are believed."""

from __future__ import annotations

from lidar_emu.runtime.feed.live_truth_source import TruthSenders, sender_name


def test_the_sender_of_the_first_truth_is_believed_from_then_on() -> None:
    senders = TruthSenders([])
    assert senders.believes(("127.0.0.1", 4000))
    assert senders.believes(("127.0.0.1", 4001))  # no truth was accepted yet
    senders.accepted(("127.0.0.1", 4001))
    senders.accepted(("127.0.0.1", 4001))
    assert not senders.believes(("127.0.0.1", 4000))
    assert senders.believes(("127.0.0.1", 4001))
    assert (senders.ignored, senders.believed) == (1, "127.0.0.1:4001")


def test_allowed_senders_are_believed_whoever_is_first() -> None:
    senders = TruthSenders(["10.0.0.7", "10.0.0.8:4000", "[::1]:4000", "fe80::1"])
    senders.accepted(("10.0.0.7", 1))
    believed = [("10.0.0.7", 9), ("10.0.0.8", 4000), ("::1", 4000, 0, 0), ("fe80:0::1", 5, 0, 0)]
    assert all(map(senders.believes, believed))
    assert not any(map(senders.believes, [("10.0.0.8", 4001), ("10.0.0.9", 4000), ("::1", 4001, 0, 0)]))
    assert senders.ignored == 3


def test_names_for_the_user() -> None:
    senders = [("127.0.0.1", 4000), ("::1", 4000, 0, 0), "/run/simulator", None]
    assert [sender_name(sender) for sender in senders] == [
        "127.0.0.1:4000",
        "[::1]:4000",
        "/run/simulator",
        "a socket without a name",
    ]
