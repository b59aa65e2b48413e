"""Scenarios mean what their authors expect: values, parts by reference, bases, overrides."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from lidar_emu.errors import InputError
from lidar_emu.scenario.instrument import Instrument
from lidar_emu.scenario.load import load, shipped_scenarios
from lidar_emu.scenario.parts import shipped
from lidar_emu.scenario.scanner import AltitudeSwitch, Square
from lidar_emu.scenario.schema import BenchScenario, FlightScenario
from lidar_emu.scenario.site import ElevationGrid, Plane
from lidar_emu.scenario.trajectory import Profile, Table

BENCH = "name: bench\nbench_pattern: {duration_s: 1, beams: [{range_m: 100, closing_speed_mps: 5}]}\n"
FLIGHT = """\
name: hop
instrument: ndl_fine
site: SITE
scanner: ndl_four_beam
trajectory: {kind: profile, waypoints: [{altitude_m: 200, speed_mps: 20}, {altitude_m: 100, speed_mps: 10}]}
"""


def bench(tmp_path: Path, text: str = "") -> BenchScenario:
    """The bench pattern with more lines."""
    (tmp_path / "bench.yaml").write_text(BENCH + text)
    scenario = load(tmp_path / "bench.yaml")
    assert isinstance(scenario, BenchScenario)
    return scenario


def flight(tmp_path: Path, site: str, overrides: dict[str, str] | None = None) -> FlightScenario:
    """The flight over a site as the scenario names or states it."""
    (tmp_path / "hop.yaml").write_text(FLIGHT.replace("SITE", site))
    scenario = load(tmp_path / "hop.yaml", overrides)
    assert isinstance(scenario, FlightScenario)
    return scenario


@pytest.mark.parametrize("name", shipped_scenarios())
def test_shipped_scenarios_load_by_name_and_by_path(name: str) -> None:
    by_name = load(name)
    assert by_name == load(shipped("scenarios") / name) == load(name.removesuffix(".yaml"))
    assert by_name.name == name.removesuffix(".yaml")


def test_a_file_comes_before_a_shipped_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "descent.yaml").write_text(BENCH)
    monkeypatch.chdir(tmp_path)
    assert load("descent.yaml").name == "bench"


@pytest.mark.parametrize(
    ("text", "rate_hz"),
    [
        ("1e2", 100.0),
        ("1.0E+2", 100.0),
        ("100", 100.0),
        ("010", 10.0),
        ("0o10", 8.0),
        ("0x10", 16.0),
        ("+5", 5.0),
    ],
)
def test_numbers(tmp_path: Path, text: str, rate_hz: float) -> None:
    assert bench(tmp_path, f"timing: {{rate_hz: {text}}}").timing.rate_hz == rate_hz


@pytest.mark.parametrize(
    "text", ["12:30:45", "1:30", "on", "no", "2030-01-01", "2030-01-01T12:00:00Z", "1.2.3", "ü"]
)
def test_text_stays_text(tmp_path: Path, text: str) -> None:
    (tmp_path / "named.yaml").write_text(BENCH.replace("name: bench", f"name: {text}"), encoding="utf-8")
    assert load(tmp_path / "named.yaml").name == text


@pytest.mark.parametrize(
    ("word", "valid"),
    [
        ("on", True),
        ("off", False),
        ("yes", True),
        ("No", False),
        ("true", True),
        ("False", False),
        ("'off'", False),
    ],
)
def test_switches(tmp_path: Path, word: str, valid: bool) -> None:
    (tmp_path / "bench.yaml").write_text(BENCH.replace("speed_mps: 5", f"speed_mps: 5, valid: {word}"))
    scenario = load(tmp_path / "bench.yaml")
    assert isinstance(scenario, BenchScenario)
    assert scenario.bench_pattern.beams[0].valid is valid


NOON = datetime(2030, 6, 1, 12, tzinfo=UTC)


@pytest.mark.parametrize(
    ("text", "epoch"),
    [
        ("2030-06-01T12:00:00Z", NOON),
        ("'2030-06-01T12:00:00Z'", NOON),
        ("2030-06-01 12:00:00", NOON),
        ("2030-06-01T12:00:00", NOON),
        ("2030-06-01T14:00:00+02:00", NOON),
        ("2030-06-01T12:00:00.250Z", NOON + timedelta(milliseconds=250)),
    ],
)
def test_epochs(tmp_path: Path, text: str, epoch: datetime) -> None:
    read = bench(tmp_path, f"timing: {{epoch: {text}}}").timing.epoch
    assert read == epoch
    assert read.tzinfo is not None


def test_a_byte_order_mark_is_no_text(tmp_path: Path) -> None:
    (tmp_path / "bench.yaml").write_bytes(b"\xef\xbb\xbf" + BENCH.encode())
    assert load(tmp_path / "bench.yaml").name == "bench"


def test_a_merge_key_merges(tmp_path: Path) -> None:
    text = BENCH.replace("beams: [", "beams: [&beam ").replace("}]}", "}, {<<: *beam, range_m: 7}]}")
    (tmp_path / "bench.yaml").write_text(text)
    scenario = load(tmp_path / "bench.yaml")
    assert isinstance(scenario, BenchScenario)
    assert [beam.range_m for beam in scenario.bench_pattern.beams] == [100, 7]
    assert scenario.bench_pattern.beams[1].closing_speed_mps == 5


def test_parts_are_shipped_ones_unless_a_file_lies_beside(tmp_path: Path) -> None:
    assert flight(tmp_path, "mars").site.body.name == "Mars"
    (tmp_path / "mars.yaml").write_text("body: {name: Phobos, radius_m: 11e3}\nground: {kind: sphere}\n")
    assert flight(tmp_path, "mars").site.body.name == "Phobos"
    assert flight(tmp_path, "mars.yaml").site.body.name == "Phobos"
    assert flight(tmp_path, str(tmp_path / "mars.yaml")).site.body.name == "Phobos"


def test_a_base_gives_what_is_not_stated(tmp_path: Path) -> None:
    site = flight(tmp_path, "{base: mars, surface: {reflectance: 0.3}}").site
    mars = flight(tmp_path, "mars").site
    assert site.surface.reflectance == 0.3
    assert site.surface.lommel_seeliger_share == mars.surface.lommel_seeliger_share == 0.5
    assert site.body == mars.body


def test_a_file_of_its_own_may_have_a_base(tmp_path: Path) -> None:
    inline = "{base: ndl_four_beam, optics: {laser_power_w: 0.5}}"
    (tmp_path / "my_lidar.yaml").write_text("base: ndl_four_beam\noptics: {laser_power_w: 0.5}\n")
    (tmp_path / "brighter.yaml").write_text("base: my_lidar\noptics: {laser_power_w: 0.8}\n")

    def instrument(part: str, overrides: dict[str, str] | None = None) -> Instrument:
        return flight(tmp_path, "flat", {"instrument": part} | (overrides or {})).instrument

    assert instrument("my_lidar") == instrument(inline) != instrument("ndl_four_beam")
    assert instrument("brighter").optics.laser_power_w == 0.8
    changed = instrument("{base: brighter, optics: {laser_power_w: 0.9}}")
    assert changed == instrument("brighter", {"instrument.optics.laser_power_w": "0.9"})


def test_files_of_a_base_are_relative_to_the_base(tmp_path: Path) -> None:
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "crater.yaml").write_text("ground: {kind: grid, file: crater.npz}\n")
    (tmp_path / "parts" / "bright.yaml").write_text("base: crater\nsurface: {reflectance: 0.4}\n")
    site = flight(tmp_path, "parts/bright.yaml").site
    assert isinstance(site.ground, ElevationGrid)
    assert (Path(site.ground.file), site.surface.reflectance) == (tmp_path / "parts" / "crater.npz", 0.4)


def test_a_file_of_a_shipped_name_may_be_based_on_the_shipped_one(tmp_path: Path) -> None:
    (tmp_path / "mars.yaml").write_text("base: mars\nsurface: {reflectance: 0.3}\n")
    site = flight(tmp_path, "mars").site
    assert (site.body.name, site.surface.reflectance) == ("Mars", 0.3)


@pytest.mark.parametrize(
    ("text", "key", "finding"),
    [
        ("base: nosuch", "base", "no other such file: 'nosuch'"),
        ("base: second", "base", "no other such file: 'first'"),
        ("base: [mars]", "base", 'must be the name of a file (got ["mars"])'),
        (
            "base: mars\nsurface: {reflectance: 3}",
            "surface.reflectance",
            "must be less than or equal to 1 (got 3)",
        ),
        ("base: mars\nsurface: {shine: 3}", "surface.shine", "no such key"),
    ],
)
def test_a_wrong_base_of_a_file_is_refused(tmp_path: Path, text: str, key: str, finding: str) -> None:
    (tmp_path / "first.yaml").write_text(text)
    (tmp_path / "second.yaml").write_text("base: first")
    with pytest.raises(InputError) as refused:
        flight(tmp_path, "first")
    assert Path(refused.value.where).name == ("second.yaml" if text == "base: second" else "first.yaml")
    assert refused.value.key == key
    assert finding in str(refused.value)


def test_another_kind_replaces_the_ground_of_a_base(tmp_path: Path) -> None:
    assert flight(tmp_path, "{base: mare, ground: {kind: plane, slope_deg: 3}}").site.ground == Plane(
        kind="plane", slope_deg=3
    )
    ground = flight(tmp_path, "{base: mare, ground: {beyond: sphere}}").site.ground
    assert isinstance(ground, ElevationGrid)
    assert ground.beyond == "sphere"
    assert Path(ground.file) == shipped("ground") / "mare.npz"


def test_files_are_relative_to_the_file_that_names_them(tmp_path: Path) -> None:
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "crater.yaml").write_text("ground: {kind: grid, file: crater.npz}\n")
    named = flight(tmp_path, "parts/crater.yaml").site.ground
    stated = flight(tmp_path, "{ground: {kind: grid, file: crater.npz}}").site.ground
    replaced = flight(tmp_path, "{base: parts/crater.yaml, ground: {file: other.npz}}").site.ground
    absolute = flight(tmp_path, "{ground: {kind: grid, file: /data/crater.npz}}").site.ground
    files = [
        Path(ground.file)
        for ground in (named, stated, replaced, absolute)
        if isinstance(ground, ElevationGrid)
    ]
    assert files == [
        tmp_path / "parts" / "crater.npz",
        tmp_path / "crater.npz",
        tmp_path / "other.npz",
        Path("/data/crater.npz"),
    ]


def test_shipped_ground_is_found_unless_a_file_lies_beside(tmp_path: Path) -> None:
    def file() -> Path:
        ground = flight(tmp_path, "{ground: {kind: grid, file: mare.npz}}").site.ground
        assert isinstance(ground, ElevationGrid)
        return Path(ground.file)

    assert file() == shipped("ground") / "mare.npz"
    (tmp_path / "mare.npz").touch()
    assert file() == tmp_path / "mare.npz"


def test_own_files_in_shipped_scenarios_are_relative_to_the_working_directory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "crater.yaml").write_text("ground: {kind: grid, file: crater.npz}\n")
    for site in ("{ground: {kind: grid, file: crater.npz}}", "crater.yaml", "crater"):
        ground = load("descent", {"site": site}).site.ground
        assert isinstance(ground, ElevationGrid)
        assert Path(ground.file).absolute() == tmp_path / "crater.npz"
    (tmp_path / "mare.yaml").write_text("ground: {kind: grid, file: crater.npz}\n")
    shipped_ground = load("descent", {"site": "mare"}).site.ground
    assert isinstance(shipped_ground, ElevationGrid)
    assert Path(shipped_ground.file).name == "mare.npz"


def test_a_table_lies_beside_the_part_that_names_it(tmp_path: Path) -> None:
    (tmp_path / "flights").mkdir()
    part = "kind: table\nfile: apollo.csv\ntime: {column: t, unit: s}\nup: {column: z, unit: ft}\n"
    (tmp_path / "flights" / "apollo.yaml").write_text(part)
    trajectory = flight(tmp_path, "flat", {"trajectory": "flights/apollo.yaml"}).trajectory
    assert isinstance(trajectory, Table)
    assert Path(trajectory.file) == tmp_path / "flights" / "apollo.csv"


def test_overrides_reach_into_parts_given_by_name(tmp_path: Path) -> None:
    overrides = {
        "site.surface.reflectance": "0.4",
        "instrument.detection.window": "hann",
        "scanner.switches.0.below_m": "300",
        "scanner.pattern.angle_deg": "10",
        "trajectory.waypoints.1.altitude_m": "50",
    }
    scenario = flight(tmp_path, "mare", overrides)
    assert scenario.site.surface.reflectance == 0.4
    assert scenario.site.surface.lommel_seeliger_share == 1.0
    assert scenario.instrument.detection.window == "hann"
    assert scenario.instrument.detection.combine == "least_squares"
    (switch,) = scenario.scanner.switches
    assert isinstance(switch, AltitudeSwitch)
    assert (switch.below_m, switch.datum) == (300, "origin")
    assert scenario.scanner.pattern == Square(kind="square", angle_deg=10)
    assert isinstance(scenario.trajectory, Profile)
    assert [point.altitude_m for point in scenario.trajectory.waypoints] == [200, 50]


def test_overrides_replace_whole_parts_and_make_mappings() -> None:
    scenario = load("descent", {"site": "flat", "mounting.roll_deg": "3", "wire": "{unit: 2}"})
    assert isinstance(scenario, FlightScenario)
    assert scenario.site.name == "flat"
    assert scenario.mounting.roll_deg == 3
    assert scenario.wire.unit == 2


def test_a_replaced_kind_of_ground_leaves_nothing_of_the_old_one() -> None:
    scenario = load("descent", {"site.ground.kind": "sphere"})
    assert isinstance(scenario, FlightScenario)
    assert scenario.site.ground.kind == "sphere"
    assert scenario.site.surface.lommel_seeliger_share == 1.0


@pytest.mark.parametrize(
    ("site", "overrides", "where", "key"),
    [
        ("bad_site", {}, "bad_site.yaml", "surface.reflectance"),
        ("{base: bad_site}", {}, "bad_site.yaml", "surface.reflectance"),
        ("{base: bad_site, surface: {reflectance: 3}}", {}, "hop.yaml", "site.surface.reflectance"),
        ("{base: bad_site, name: own}", {}, "bad_site.yaml", "surface.reflectance"),
        ("bad_site", {"site.surface.reflectance": "3"}, "overrides", "site.surface.reflectance"),
        ("bad_site", {"site.name": "own"}, "bad_site.yaml", "surface.reflectance"),
        ("flat", {"site": "bad_site"}, "bad_site.yaml", "surface.reflectance"),
        ("flat", {"site.surface.shine": "1"}, "overrides", "site.surface.shine"),
        (
            "flat",
            {"site": "{base: bad_site, surface: {reflectance: 3}}"},
            "overrides",
            "site.surface.reflectance",
        ),
    ],
)
def test_complaints_name_who_stated_the_value(
    tmp_path: Path, site: str, overrides: dict[str, str], where: str, key: str
) -> None:
    (tmp_path / "bad_site.yaml").write_text("ground: {kind: plane}\nsurface: {reflectance: 2}\n")
    with pytest.raises(InputError) as refused:
        flight(tmp_path, site, overrides)
    assert Path(refused.value.where).name == where
    assert refused.value.key == key
