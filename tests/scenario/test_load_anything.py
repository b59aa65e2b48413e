"""Whatever a file or an override holds, loading it succeeds or states in one line what is wrong."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lidar_emu.campaign.requirements import read_requirements
from lidar_emu.errors import InputError
from lidar_emu.scenario.load import load
from lidar_emu.scenario.parts import shipped
from lidar_emu.scenario.yaml_text import parse
from lidar_emu.trial.pack import read_pack

DESCENT = (shipped("scenarios") / "descent.yaml").read_text()
BENCH = (shipped("scenarios") / "bench.yaml").read_text()
REQUIREMENTS = """requirements:
  - {id: A-1, text: Speeds are near., run: speed_error_mps_abs_p95, at_most: 0.001, probability: 0.95, confidence: 0.95}
  - id: A-2
    text: Ranges are there.
    shot: range_valid
    at_least: 1
    range_m: [0, 1500]
    altitude_m: [20, 500]
    share: 0.97
    probability: 0.9
    confidence: 0.95
"""
PACK = """name: mine
requirements:
  - {id: A, text: Errors are small., solution: altitude_error_m_abs, at_most: 5, altitude_m: [0, 500], share: 0.9}
cases:
  - {id: one, question: Why?, scenario: descent.yaml, set: {timing.rate_hz: 10, duration_s: 5}, flights: 2}
  - id: two
    question: Why not?
    scenario: powered_descent.yaml
    requirements: [{id: B, text: It lands., flight: touchdown_speed_mps, at_most: 2, probability: 0.9}]
"""
FRAGMENTS = [
    *("name", "site", "timing", "kind", "file", "ground", "base", "bench_pattern", "epoch", "plane", "a", "x"),
    *(": ", ":", "\n", "\n  ", "\n    - ", "- ", "[", "]", "{", "}", ", ", "? ", "|\n", ">\n", "'", '"', "#", "\t"),
    *("&a ", "*a", "<<: *a", "<<", "!!set ", "!!bool ", "!!int ", "!!omap ", "!!binary ", "!!float ", "!x ", "!"),
    *("1", "-1", "1e400", ".nan", "-.inf", "0x1F", "010", "12:30:45", "2030-01-01", "2030-99-99T25:61:61Z", "~"),
    *("on", "true", "null", "---\n", "...\n", "%YAML 1.1\n", "%TAG ! y\n", "\\ud800", "\\0", "\0", "\ufeff", "²"),
]  # fmt: skip

yaml_like = st.lists(st.sampled_from(FRAGMENTS) | st.text(max_size=3), max_size=30).map("".join)
values = st.recursive(
    st.none()
    | st.booleans()
    | st.integers()
    | st.floats()
    | st.sampled_from(["plane", "grid", "ramp", "flat", "hann", "", "/"])
    | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=6,
)
keys = st.sampled_from(
    [
        *("name", "seed", "duration_s", "timing", "timing.rate_hz", "timing.epoch", "timing.late_after_s", "wire.unit"),
        *("instrument", "instrument.waveform", "instrument.waveform.fft_length", "instrument.waveform.sample_rate_hz"),
        *("instrument.waveform.segment_time_s", "instrument.optics.beamlets", "instrument.detection.window", "1"),
        *("instrument.detection.maximum_range_m", "site", "site.ground", "site.ground.kind", "site.ground.file"),
        *("site.ground.band", "site.ground.origin", "site.ground.origin.map_x_m", "site.base", "site.name"),
        *("scanner", "scanner.pattern", "scanner.pattern.kind", "scanner.switches", "scanner.switches.0", "x.y.z"),
        *("scanner.switches.0.kind", "scanner.switches.0.pattern", "scanner.misalignment_mrad", "trajectory.kind"),
        *("trajectory", "trajectory.waypoints", "trajectory.waypoints.0", "trajectory.waypoints.1.altitude_m"),
        *("trajectory.waypoints.9.speed_mps", "mounting.lever_arm_m", "mounting.lever_arm_m.1", "bench_pattern"),
        "mounting",
        *("bench_pattern.beams.0", "bench_pattern.beams.0.range_m", "bench_pattern.beams.1.range_m.start", "0", ".."),
    ]
)  # fmt: skip


def load_pack(file: Path) -> object:
    return read_pack(str(file), [])


def loads_or_refuses(read: Callable[..., Any], *arguments: Any) -> None:
    try:
        read(*arguments)
    except InputError as refused:
        line = str(refused)
        assert line
        assert line.isprintable()


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("anything") / "my.yaml"


@settings(max_examples=150, deadline=None)
@given(text=yaml_like | st.text(), read=st.sampled_from([load, read_requirements, load_pack]))
def test_any_text(file: Path, text: str, read: Callable[[Path], Any]) -> None:
    file.write_bytes(text.encode(errors="surrogatepass"))
    loads_or_refuses(read, file)


@settings(max_examples=150, deadline=None)
@given(
    text_and_reader=st.sampled_from(
        [(DESCENT, load), (BENCH, load), (REQUIREMENTS, read_requirements), (PACK, load_pack)]
    ),
    cuts=st.lists(
        st.tuples(st.integers(0, len(DESCENT)), st.integers(0, 20), yaml_like), min_size=1, max_size=4
    ),
)
def test_a_file_with_parts_replaced(
    file: Path, text_and_reader: tuple[str, Callable[[Path], Any]], cuts: list[tuple[int, int, str]]
) -> None:
    whole, read = text_and_reader
    for start, length, new in cuts:
        start %= len(whole) + 1
        whole = whole[:start] + new + whole[start + length :]
    file.write_bytes(whole.encode(errors="surrogatepass"))
    loads_or_refuses(read, file)


@settings(max_examples=150, deadline=None)
@given(
    scenario=st.sampled_from(["descent", "bench"]),
    overrides=st.dictionaries(
        keys | st.text(max_size=6), values.map(repr) | yaml_like, min_size=1, max_size=3
    ),
)
def test_a_shipped_scenario_with_any_overrides(scenario: str, overrides: dict[str, str]) -> None:
    loads_or_refuses(load, scenario, overrides)


@settings(max_examples=50, deadline=None)
@given(name=st.text(max_size=300))
def test_any_name_of_a_scenario(name: str) -> None:
    loads_or_refuses(load, name)


@pytest.mark.parametrize("number", ["9" * 101, "0x" + "f" * 100, "1" + ":10" * 40, "1." + "0" * 100])
def test_a_number_of_any_length_is_not_computed(number: str) -> None:
    """The last of base 60, as in YAML 1.1: to read a million characters takes minutes."""
    head = "%YAML 1.1\n---\n" if ":" in number else ""
    with pytest.raises(InputError, match=f"duration_s: a number of {len(number)} characters"):
        parse(f"{head}duration_s: {number}", "mine.yaml")


def test_many_lists_beside_each_other_are_not_deep() -> None:
    assert parse("[" + "[1], " * 2000 + "]", "a fault") == [[1]] * 2000
    for deep in ("[" * 400, "a: {" * 400, "[" * 400 + "]" * 400):
        with pytest.raises(InputError, match=r"a fault: nested too deeply; nest at most 32 deep"):
            parse(deep, "a fault")
