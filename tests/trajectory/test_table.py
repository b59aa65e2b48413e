"""Tables: what is read, what is refused and how it is reported."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from twins import APOLLO

from lidar_emu.beams.flight import build_trajectory
from lidar_emu.errors import InputError
from lidar_emu.scenario.load import load
from lidar_emu.scenario.trajectory import Table
from lidar_emu.shots.model import build_model, measure_whole
from lidar_emu.trajectory.profile import Gap, Trajectory

UP = {"column": "up", "unit": "m"}


def table(folder: Path, text: str | bytes, **keys: Any) -> Trajectory:
    file = folder / "flight.csv"
    file.write_bytes(text.encode() if isinstance(text, str) else text)
    given = {"kind": "table", "file": str(file), "time": {"column": "t", "unit": "s"}, "up": UP, **keys}
    return build_trajectory(Table.model_validate(given, strict=False))


def rows(header: str, *columns: Any) -> str:
    lines = [
        ",".join("" if np.isnan(cell) else repr(float(cell)) for cell in row)
        for row in zip(*columns, strict=True)
    ]
    return "\n".join([header, *lines, ""])


def test_units_axes_and_time(tmp_path: Path) -> None:
    """Free fall written in minutes, feet, kilometres and km/h, starting at minute 10."""
    second = np.arange(0, 13, 3.0)
    text = rows(
        "minute,down_ft,north_km,east_m,kmh",
        10 + second / 60,
        (1000 - second**2) / 0.3048,
        second * 0.02,
        -7 * second,
        -2 * second * 3.6,
    )
    flight = table(
        tmp_path,
        text,
        time={"column": "minute", "unit": "min"},
        up={"column": "down_ft", "unit": "ft", "rate_column": "kmh", "rate_unit": "km/h"},
        north={"column": "north_km", "unit": "km"},
        east={"column": "east_m", "unit": "m"},
    )
    assert flight.duration_s == pytest.approx(12, rel=1e-12)
    time_s = np.linspace(0, 12, 25)
    state = flight.state(time_s)
    expected = np.stack([-7 * time_s, 20 * time_s, 1000 - time_s**2], axis=-1)
    np.testing.assert_allclose(state.position_site_m, expected, rtol=1e-9, atol=1e-9)
    velocity = np.stack([np.full(25, -7), np.full(25, 20), -2 * time_s], axis=-1)
    np.testing.assert_allclose(state.velocity_site_mps, velocity, rtol=1e-9, atol=1e-8)
    np.testing.assert_allclose(state.acceleration_site_mps2[:, 2], -2, rtol=1e-7)


def test_part_flown_starts_at_zero_and_is_shaped_by_rows_outside(tmp_path: Path) -> None:
    time = np.arange(100, 120, 2.0)
    whole = table(tmp_path, rows("t,up", time, np.sin(time)))
    part = table(tmp_path, rows("t,up", time, np.sin(time)), from_time=105, to_time=112)
    assert part.duration_s == 7
    inside = np.linspace(0, 7, 50)
    np.testing.assert_allclose(
        part.state(inside).position_site_m, whole.state(inside + 5).position_site_m, atol=1e-12
    )


def test_nanoseconds_since_1970_keep_their_spacing(tmp_path: Path) -> None:
    text = "t,up\n1700000000000000000,9\n1700000000500000000,5\n1700000001000000000,1\n"
    flight = table(tmp_path, text, time={"column": "t", "unit": "ns"})
    assert flight.duration_s == pytest.approx(1, abs=1e-12)
    np.testing.assert_allclose(flight.state(np.array([0.25])).velocity_site_mps[:, 2], -8, rtol=1e-6)


def test_empty_cells_are_passed_over_column_by_column(tmp_path: Path) -> None:
    time = np.arange(0, 11.0)
    up, roll = 100 - 3 * time, 0.01 * time
    up[[2, 3, 7]] = np.nan
    roll[[0 + 1, 4, 5, 6]] = np.nan
    flight = table(tmp_path, rows("t,up,roll", time, up, roll), roll={"column": "roll", "unit": "rad"})
    state = flight.state(time)
    np.testing.assert_allclose(state.position_site_m[:, 2], 100 - 3 * time, rtol=1e-13)
    np.testing.assert_allclose(state.body_rate_radps, np.broadcast_to([0.01, 0, 0], (11, 3)), atol=1e-15)
    assert flight.gaps == (Gap("roll", 3.0, 4.0), Gap("up", 1.0, 3.0))


def test_rate_column_counts_only_where_both_are_filled(tmp_path: Path) -> None:
    text = "t,up,rate\n0,50,-2\n1,,-9\n2,47,\n4,40,-3\n"
    flight = table(tmp_path, text, up={**UP, "rate_column": "rate", "rate_unit": "m/s"})
    state = flight.state(np.array([0.0, 4.0]))
    assert state.position_site_m[:, 2].tolist() == [50, 40]
    np.testing.assert_allclose(state.velocity_site_mps[:, 2], [-2, -3], rtol=1e-14)
    assert flight.gaps == (Gap("up with rate", 0.0, 4.0),)


def test_angles_go_on_through_a_full_turn_and_heed_their_sign(tmp_path: Path) -> None:
    time = np.arange(0, 8.0)
    heading_deg = (170 + 10 * time + 180) % 360 - 180
    flight = table(
        tmp_path,
        rows("t,up,psi", time, 50 - time, -heading_deg),
        yaw={"column": "psi", "unit": "deg", "sign": -1},
    )
    time_s = np.linspace(0, 7, 15)
    state = flight.state(time_s)
    heading = np.radians(170 + 10 * time_s)
    forward = np.stack([np.sin(heading), np.cos(heading), 0 * heading], axis=-1)
    np.testing.assert_allclose(state.site_from_body[:, :, 0], forward, atol=1e-13)
    np.testing.assert_allclose(state.body_rate_radps[:, 2], np.radians(10), rtol=1e-12)


def test_quaternions_agree_with_scipys_and_are_normalised(tmp_path: Path) -> None:
    time = np.arange(0, 5.0)
    turns = Rotation.from_rotvec(0.2 * time[:, None] * np.array([0.6, 0.0, 0.8]))
    w, x, y, z = 1.0005 * np.roll(turns.as_quat(), 1, axis=1).T
    flight = table(
        tmp_path,
        rows("t,up,w,x,y,z", time, 9 - time, w, x, y, z),
        quaternion={"columns": ("w", "x", "y", "z")},
    )
    state = flight.state(time)
    np.testing.assert_allclose(state.site_from_body, turns.as_matrix(), atol=1e-14)
    np.testing.assert_allclose(state.body_rate_radps, np.broadcast_to([0.12, 0, 0.16], (5, 3)), atol=1e-13)


def test_measured_body_rates_stand_for_the_derived_ones(tmp_path: Path) -> None:
    text = rows("t,up,p,q,r", [0, 1, 2], [9, 8, 7], [1, 2, 3], [0, 0, 0], [-9, np.nan, -5])
    flight = table(tmp_path, text, body_rates={"columns": ("p", "q", "r"), "unit": "deg/s"})
    rate = np.degrees(flight.state(np.array([0.5, 1.0])).body_rate_radps)
    np.testing.assert_allclose(rate, np.array([[1.5, 0, -8], [2, 0, -7]]), atol=1e-13)


def test_bits_do_not_depend_on_the_block(tmp_path: Path) -> None:
    rng = np.random.default_rng(8)
    time = np.cumsum(rng.uniform(0.2, 1, 30))
    text = rows("t,up,east,roll,yaw", time, *rng.normal(size=(4, 30)))
    angles = {name: {"column": name, "unit": "rad"} for name in ("roll", "yaw")}
    flight = table(tmp_path, text, east={"column": "east", "unit": "km"}, **angles)
    time_s = rng.uniform(-0.1, flight.duration_s + 0.1, 200)
    whole = flight.state(time_s)
    for k in range(len(time_s)):
        single = flight.state(time_s[k : k + 1])
        for name, values in whole._asdict().items():
            assert np.array_equal(values[k : k + 1], getattr(single, name)), name


def test_quotes_blanks_byte_order_mark_and_empty_lines(tmp_path: Path) -> None:
    text = b'\xef\xbb\xbf "t" , up ,note\r\n\r\n0, 9,"a, b"\r\n1 ,8\r\n,,\r\n2,7,\r\n'.replace(
        b' "t" ', b'"t"'
    )
    flight = table(tmp_path, text)
    np.testing.assert_allclose(flight.state(np.array([1.5])).position_site_m, [[0, 0, 7.5]])


@pytest.mark.parametrize(
    ("text", "keys", "reported"),
    [
        ("\n\n", {}, ("empty file",)),
        ("t,up\n", {}, ("0 rows", "at least 2")),
        ("t,up\n0,1\n", {}, ("1 rows", "at least 2")),
        ("t,up\n0,1\n1,\n", {}, ("up", "1 filled rows")),
        ("t,up,up\n0,1,1\n1,2,2\n", {}, ("'up'", "once")),
        ("t,up\n0,1\n1,nan\n", {}, ("line 3, up", "'nan'")),
        ("t,up\n0,1\n1,-inf\n", {}, ("line 3, up", "'-inf'")),
        ("t,up\n0,1\n1,1e999\n", {}, ("line 3, up", "'1e999'")),
        ("t,up\n0,1\n1,1_0\n", {}, ("line 3, up", "'1_0'")),
        ("t,up\n0,1\n1,2;3\n", {}, ("line 3, up", "'2;3'")),
        ("t,up\n0,1\n1,2,3\n", {}, ("line 3", "3 cells")),
        ("t,up\n0,1\n,2\n", {}, ("line 3, t", "a time in every row")),
        ("t,up\n0,1\n2,2\n2,3\n", {}, ("line 4, t", "above 2", "(got 2.0)")),
        ("t,up\n0,1\n2,2\n1,3\n", {}, ("line 4, t", "above 2", "(got 1.0)")),
        ("t,up\n0,1\n5,\n11,2\n", {}, ("up", "11 s after 0")),
        ("t,up\n0,1\n5,2\n", {"from_time": -1.0}, ("from_time", "-1.0", "0 to 5")),
        ("t,up\n0,1\n5,2\n", {"to_time": 6.0}, ("to_time", "6.0", "0 to 5")),
        (
            "t,up\n0,1\n5,2\n",
            {"from_time": 4.0, "to_time": 3.0},
            ("to_time: must be above 4, from_time (got 3.0)",),
        ),
        ("t,up\n0,1\n5,2\n", {"from_time": 5.0}, ("to_time: must be above 5, from_time (got 5.0)",)),
        ("t,up\n0,\n1,5\n2,4\n", {}, ("up", "no value before 1", "from_time: 1 or later")),
        ("t,up\n0,6\n1,5\n2,\n", {}, ("up", "no value after 1", "to_time: 1 or earlier")),
        (b"t,up\n0,6\n1,\xff\n", {}, ("UTF-8",)),
        (b't,up\n0,6\n1,"5\n', {}, ("CSV",)),
        (b"t,up\n0,6\n1,5\x00\n", {}, ("line",)),
        (
            "t,up,w,x,y,z\n0,6,1,0,0,0\n1,5,0.5,0,0,0\n",
            {"quaternion": {"columns": ("w", "x", "y", "z")}},
            ("line 3, w x y z", "length 0.5"),
        ),
    ],
)
def test_refusals_name_file_place_and_value(
    tmp_path: Path, text: str | bytes, keys: dict[str, Any], reported: tuple[str, ...]
) -> None:
    with pytest.raises(InputError) as refused:
        table(tmp_path, text, **keys)
    message = str(refused.value)
    assert message.startswith(str(tmp_path / "flight.csv"))
    assert "\n" not in message
    assert all(part in message for part in reported)


def test_gaps_outside_the_part_flown_do_not_matter(tmp_path: Path) -> None:
    text = "t,up\n0,9\n50,8\n51,7\n53,6\n99,5\n"
    flight = table(tmp_path, text, from_time=50, to_time=53)
    assert flight.gaps == (Gap("up", 1.0, 2.0),)
    with pytest.raises(InputError, match="50 s after 0"):
        table(tmp_path, text, from_time=49, to_time=53)


def test_a_gap_of_just_the_maximum_is_bridged(tmp_path: Path) -> None:
    flight = table(tmp_path, "t,up\n0.1,9\n0.4,8\n", maximum_gap_s=0.3)
    assert flight.gaps[0].length_s == pytest.approx(0.3)


def test_longer_gaps_are_bridged_where_that_is_asked_for_and_reported(tmp_path: Path) -> None:
    text = "t,up,roll\n0,50,0\n4,46,\n5,45,0\n6,44,\n30,20,1\n31,19,2\n"
    keys = {"maximum_gap_s": 5, "roll": {"column": "roll", "unit": "deg"}}
    flight = table(tmp_path, text, longer_gaps="bridge", **keys)
    assert flight.bridged == (Gap("roll", 5.0, 25.0), Gap("up", 6.0, 24.0))
    np.testing.assert_allclose(flight.state(np.array([18.0])).position_site_m[:, 2], 32, rtol=1e-12)
    with pytest.raises(InputError, match=r"24 s after 6.*maximum_gap_s above 5, or longer_gaps: bridge"):
        table(tmp_path, text, **keys)


def test_rows_without_end_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lidar_emu.trajectory.table._MOST_ROWS", 4)
    text = "t,up\n0,1\n1,2\n2,3\n"
    assert table(tmp_path, text).duration_s == 2
    with pytest.raises(InputError, match="more than 4 rows; split it"):
        table(tmp_path, text + "3,4\n")


def test_flies_as_it_is_and_states_where_it_knows_nothing(public_data: Path) -> None:
    file = public_data / APOLLO
    given = {
        "kind": "table",
        "file": str(file),
        "time": {"column": "t_touchdown_s", "unit": "s"},
        "up": {"column": "alt_m", "unit": "m", "rate_column": "hdot_mps", "rate_unit": "m/s"},
        "to_time": 0,
        "longer_gaps": "bridge",
    }
    scenario = load(
        "descent.yaml", {"trajectory": json.dumps(given), "timing.rate_hz": "1", "level": "geometric"}
    )
    model = build_model(scenario)
    run = measure_whole(model)
    with file.open() as stream:
        time = np.array([float(row["t_touchdown_s"]) for row in csv.DictReader(stream)])
    before = np.searchsorted(time, run.time_s[:, 0] + time[0], side="right") - 1
    expected = np.diff(time)[before] > 10
    np.testing.assert_array_equal(run.true_in_gap[:, 0], expected)
    assert len(run) == 755
    assert run.true_in_gap[:, 0].sum() == 322
    reported = [d for d in model.plan.decisions if d.stage == "gap"]
    assert [d.how for d in reported][-1] == "bridged from 564.0 s to 596.0 s"
    assert len(reported) == np.count_nonzero(np.diff(time) > 10) == 9
    assert run.table()["true_in_gap"].sum() == 4 * expected.sum()


BESIDE = {
    "yaw": {"column": "a", "unit": "rad"},
    "quaternion": {"columns": ["a", "x", "y", "z"]},
    "body_rates": {"columns": ["a", "x", "y"], "unit": "rad/s"},
}


@pytest.mark.parametrize("kind", BESIDE)
def test_an_angle_or_rate_that_is_no_number_of_a_vehicle_is_refused_by_its_line(
    tmp_path: Path, kind: str
) -> None:
    rows = "t,up,a,x,y,z\n0,0,1,0,0,0\n1,1,1e300,0,0,0\n"
    with pytest.raises(InputError, match=r"line 3, a.*(at most 1e\+06 deg|of length inf)"):
        table(tmp_path, rows, **{kind: BESIDE[kind]})


@pytest.mark.parametrize(
    ("rows", "words"),
    [
        ("-1e308,0\n1e308,1\n", r"line 2, t: must be at most 1e\+12 s"),
        ("0,0\n1e-320,1\n", "line 3, t: must be above 0, the time before, by at least 1e-12 s"),
    ],
)
def test_times_whose_rates_are_no_numbers_are_refused_by_their_line(
    tmp_path: Path, rows: str, words: str
) -> None:
    with pytest.raises(InputError, match=words):
        table(tmp_path, f"t,up\n{rows}")


@pytest.mark.parametrize(
    ("cell", "unit", "most"),
    [
        ("1e200", "m", "1e+09 m"),
        ("-1e308", "km", "1e+09 m"),
        ("-1.1e9", "m", "1e+09 m"),
        ("1.1e6", "km", "1e+09 m"),
    ],
)
def test_a_height_beyond_any_orbit_is_refused_by_its_line(
    tmp_path: Path, cell: str, unit: str, most: str
) -> None:
    with pytest.raises(InputError, match=r"line 3, up: must be at most") as refused:
        table(tmp_path, f"t,up\n0,100\n1,{cell}\n2,90\n", up={"column": "up", "unit": unit})
    assert most in str(refused.value)
    rate = {"column": "up", "unit": "m", "rate_column": "v", "rate_unit": "m/s"}
    with pytest.raises(InputError, match=r"line 2, v: must be at most 3e\+08 m/s"):
        table(tmp_path, "t,up,v\n0,100,1e9\n1,99,0\n", up=rate)
