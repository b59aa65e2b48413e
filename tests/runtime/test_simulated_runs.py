"""Whole runs in simulated time, each under one seed: their invariants, that they repeat, and that defects are found."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest
from simulated_runtime.plan import Happening, Plan, draw
from simulated_runtime.shorten import shorten
from simulated_runtime.simulation import simulate

from lidar_emu.recording.write import Recorder
from lidar_emu.runtime.port.packets import OutgoingPacket
from lidar_emu.runtime.port.sender import Sender
from lidar_emu.runtime.summary import Tally
from lidar_emu.session import Session
from lidar_emu.transports.byte_channel import DescriptorChannel
from lidar_emu.transports.link import DeliveryStatus

_PARTS, _SEEDS = 4, 160
"""About a minute."""


@pytest.mark.slow
@pytest.mark.parametrize("part", range(_PARTS))
def test_what_is_sent_counted_recorded_and_decoded_agrees(part: int) -> None:
    for seed in range(part, _SEEDS, _PARTS):
        plan = draw(seed)
        try:
            simulate(plan)
        except Exception as error:
            pytest.fail(
                f"{type(error).__name__}: {error}\n{plan}\nmake simulate-runtime SEEDS={seed}:{seed + 1}"
            )


@pytest.mark.slow
@pytest.mark.parametrize("seed", [5, 6, 7, 8])
def test_a_seed_repeats_exactly(seed: int) -> None:
    assert simulate(draw(seed)) == simulate(draw(seed))


CALM = replace(
    draw(0),
    scenario="descent.yaml",
    settings={"level": "geometric", "timing.rate_hz": "100", "duration_s": "1.0"},
    link="serial",
    baud=921_600,
    pace="wall",
    start=None,
    control=False,
    shot_ns=5_000,
    happenings=(
        Happening(200_000_000, "stall line", (400_000_000,)),
        Happening(700_000_000, "command", ("set_mode", {"mode": "standby"}, "whole")),
        Happening(900_000_000, "command", ("set_mode", {"mode": "acquire"}, "whole")),
    ),
)


def test_a_command_between_the_start_of_a_flight_and_time_0_is_recomputed_from_the_shot_that_it_changed() -> (
    None
):
    acquire = Happening(500_000_000, "command", ("set_mode", {"mode": "acquire"}, "whole"))
    slower = Happening(550_000_000, "command", ("set_rate_hz", {"rate_hz": 25.0}, "whole"))
    settings = {**CALM.settings, "device.start": "standby"}
    late = replace(
        CALM, start="on-command", settings=settings, shot_ns=11_000_000, happenings=(acquire, slower)
    )
    assert late.is_recorded
    assert late.is_recomputed
    assert simulate(late).packets == 100


def torn(channel: DescriptorChannel) -> bool:
    """Forget the rest of a packet that did not fit."""
    channel._rest = b""
    return True


def twice(sender: Sender, packet: OutgoingPacket, *about: Any) -> None:
    if packet.shot == 3:
        sender._link.send(packet.payload, 0)
    COMPLETE(sender, packet, *about)


def too_often(tally: Tally, report: Any, silent: bool = False) -> None:
    ADD_REPORT(tally, report, silent)
    tally.statuses[DeliveryStatus.SENT] += report.shot == 3


def never_silent(session: Session, device: Any) -> None:
    if device.measures:
        USE_DEVICE(session, device)


def forgetful(recorder: Recorder, packet: OutgoingPacket, report: Any) -> None:
    if packet.shot != 3:
        ON_REPORT(recorder, packet, report)


COMPLETE, ADD_REPORT = Sender._complete, Tally.add_report
USE_DEVICE, ON_REPORT = Session.use_device, Recorder.on_report


@pytest.mark.parametrize(
    ("owner", "name", "defect", "found"),
    [
        (DescriptorChannel, "flush", torn, "torn"),
        (Sender, "_complete", twice, "on the line, but not reported"),
        (Tally, "add_report", too_often, "the tally counts each report"),
        (Session, "use_device", never_silent, "silent or not"),
        (Recorder, "on_report", forgetful, "recorded and reported"),
    ],
)
def test_a_defect_is_found(
    owner: type, name: str, defect: Callable[..., Any], found: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    simulate(CALM)
    monkeypatch.setattr(owner, name, defect)
    with pytest.raises(AssertionError, match=found):
        simulate(CALM)


def test_a_plan_that_fails_is_shortened_to_what_it_fails_by() -> None:
    plan = next(plan for plan in map(draw, range(100)) if len(plan.happenings) > 8)
    needed = plan.happenings[2], plan.happenings[7]

    def fails(fewer: Plan) -> bool:
        return all(each in fewer.happenings for each in needed)

    short = shorten(plan, fails)
    assert short.happenings == needed
    assert set(short.settings) == {"level", "timing.rate_hz", "duration_s"}
