"""Measured from a recorded geometry a flight has the bits that it has when it is flown."""

from __future__ import annotations

import io
import json
import tracemalloc
from dataclasses import fields
from pathlib import Path
from zipfile import ZIP_DEFLATED, ZIP_STORED, ZipFile

import numpy as np
import pytest

import lidar_emu
from lidar_emu.api import simulate
from lidar_emu.beams import geometry_file as recorded_file
from lidar_emu.errors import InputError
from lidar_emu.report import geometry_export
from lidar_emu.report.geometry_export import record_geometry
from lidar_emu.scenario.load import load
from lidar_emu.shots.model import build_model, measure_in_blocks

OVER_GROUND = {"duration_s": "12", "timing.rate_hz": "25"}


def flown(settings, scenario="descent.yaml"):
    return load(scenario, {**OVER_GROUND, **settings})


def assert_same(one, other):
    for field in fields(one):
        np.testing.assert_array_equal(
            getattr(one, field.name), getattr(other, field.name), err_msg=field.name
        )


def measured(scenario, geometry, block_shots=128):
    blocks = list(measure_in_blocks(build_model(scenario, geometry), block_shots))
    return type(blocks[0]).concatenate(blocks)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """Over a grid: 300 shots of 4 beams with 7 beamlets, misaligned in between; three blocks of them."""
    path = tmp_path_factory.mktemp("geometry") / "flight.npz"
    with pytest.MonkeyPatch.context() as patch:
        for module in (recorded_file, geometry_export):
            patch.setattr(module, "BLOCK_SHOTS", 128)
        about = record_geometry(flown(WAY), path)
    assert (about.shots, about.beams, about.beamlets) == (300, 4, 7)
    return path


WAY = {
    "instrument.optics.beamlets": "7",
    "faults": "[{kind: misalignment, tilt_mrad: [3, 1], from_s: 2, to_s: 5, probability: 0.5, lasts_s: 0.4}]",
}

SAME_GEOMETRY = {
    "as flown": {},
    "less light": {"instrument.optics.laser_power_w": "0.02", "instrument.receiver.temperature_k": "400"},
    "other bins": {"instrument.waveform.chirp_slope_hz_per_s": "1e12", "instrument.detection.peak": "hann"},
    "geometric": {"level": "geometric"},
    "one beamlet": {"instrument.optics.beamlets": "1"},
    "air": {"site.atmosphere": "{extinction_per_m: 1.0e-4}", "site.surface.lommel_seeliger_share": "1"},
    "half of it": {"duration_s": "5"},
    "nothing left out": {"left_out_share": "0", "duration_s": "2"},
}


@pytest.mark.parametrize("settings", SAME_GEOMETRY.values(), ids=SAME_GEOMETRY)
def test_through_any_receiver(settings, recorded):
    scenario = flown({**WAY, **settings})
    assert_same(measured(scenario, recorded), simulate(scenario))


def test_the_ground_itself_is_not_needed(tmp_path):
    """Nor the way over it checked again, which was when it was recorded."""
    grid = tmp_path / "dem.npz"
    np.savez(grid, elevation_m=np.random.default_rng(1).normal(size=(300, 300)), pixel_m=20.0)
    ground = f"{{ground: {{kind: grid, file: '{grid}', beyond: none}}}}"
    scenario = flown({"site": ground, "duration_s": "2", "level": "geometric"})
    record_geometry(scenario, tmp_path / "flight.npz")
    whole = simulate(scenario)
    grid.unlink()
    assert_same(measured(scenario, tmp_path / "flight.npz"), whole)


@pytest.mark.parametrize("block_shots", [1, 50, 128, 300])
def test_in_any_blocks(block_shots, recorded):
    scenario = flown(WAY)
    assert_same(measured(scenario, recorded, block_shots), simulate(scenario))


@pytest.mark.parametrize(
    ("scenario", "settings"),
    [
        ("descent.yaml", {"faults": "[{kind: clutter, range_m: 5, reflectance: 0.3}, {kind: dropout}]"}),
        ("descent.yaml", {"faults": "[{kind: reflectance_patch, centre_m: [0, 0], radius_m: 500, reflectance: 0.9}]"}),
        ("paper_fig5.yaml", {"timing.rate_hz": "5"}),
        ("nasa_three_beam.yaml", {"scanner.firing": "in_turn"}),
        ("powered_descent.yaml", {}),
        ("obstacles.yaml", {"instrument.optics.beamlets": "7", "timing.rate_hz": "300", "duration_s": "0.5"}),
        ("descent.yaml", {"scanner.switches": "[{kind: time, at_s: 1, pattern: {kind: square, angle_deg: 7.5}}]"}),
    ],
)  # fmt: skip
def test_over_scenarios(scenario, settings, tmp_path):
    asked = load(scenario, {"duration_s": "3", **settings})
    record_geometry(asked, tmp_path / "g.npz")
    assert_same(measured(asked, tmp_path / "g.npz"), simulate(asked))


def test_from_python(tmp_path):
    """Recorded and measured by the public names, which tell how far they are."""
    path, told = tmp_path / "g.npz", []
    lidar_emu.record_geometry("descent", path, duration_s=7, progress=lambda *done: told.append(done))
    dim = {"instrument.optics.laser_power_w": 0.1}
    run = simulate("descent", dim, duration_s=7, geometry=str(path), progress=lambda *done: told.append(done))
    assert told == [(140, 140), (128, 140), (140, 140)]
    assert_same(run, simulate("descent", dim, duration_s=7))
    with pytest.raises(InputError, match=r"^bench.*no geometry"):
        lidar_emu.record_geometry("bench", path)
    with pytest.raises(InputError, match=r"^simulate: geometry: must be a path \(got 3\)"):
        simulate("descent", geometry=3)


MOVING = """[
    {name: deck, kind: slab, length_m: 900, width_m: 900, height_m: 5, reflectance: 0.7,
     motion: {velocity_mps: [9, 3, 1]}},
]"""


@pytest.mark.parametrize("block_shots", [7, 128])
def test_things_that_move_keep_their_speed(block_shots, tmp_path):
    asked = flown(
        {"duration_s": "2", "site.objects": MOVING, "scanner": "{pattern: {kind: square, angle_deg: 10}}"}
    )
    record_geometry(asked, tmp_path / "g.npz")
    run = simulate(asked)
    assert_same(measured(asked, tmp_path / "g.npz", block_shots), run)
    with np.load(tmp_path / "g.npz") as archive:
        assert set(np.unique(archive["0.axis.object_id"])) == {1}
        np.testing.assert_array_equal(archive["0.axis.velocity_site_mps"][..., 0], 9)
        np.testing.assert_array_equal(archive["0.axis.reflectance"], 0.7)
    other = flown({"duration_s": "2", "site.objects": MOVING.replace("0.7", "0.6"),
                   "scanner": "{pattern: {kind: square, angle_deg: 10}}"})  # fmt: skip
    with pytest.raises(InputError, match=r"site\.objects\.0\.reflectance: must be 0\.7, as in .*got 0\.6"):
        build_model(other, tmp_path / "g.npz")


def test_holds_what_numpy_reads(recorded):
    run = simulate(flown({**WAY, "level": "geometric"}))
    with np.load(recorded) as archive:
        about = json.loads(str(archive["about"]))
        np.testing.assert_array_equal(archive["1.axis.range_m"], run.true_range_m[128:256])
        np.testing.assert_array_equal(archive["2.pointing.vehicle"][0], run.position_site_m[256:])
        np.testing.assert_allclose(archive["0.beamlets.range_m"][..., 0], run.true_range_m[:128], rtol=1e-14)
    assert about["conditions"]["instrument.optics.waist_radius_m"] == 0.017
    assert about["conditions"]["site.ground.file"] == "mare.npz"


OTHER_GEOMETRY = {
    "scanner.pattern.angle_deg": "20",
    "scanner.misalignment_mrad": "[[1, 0], [0, 0], [0, 0], [0, 0]]",
    "mounting.pitch_deg": "1",
    "timing.rate_hz": "20",
    "trajectory.waypoints.0.speed_mps": "99",
    "site.surface.reflectance": "0.5",
    "site.ground.elevation_offset_m": "3",
    "instrument.waveform.wavelength_m": "1.064e-6",
    "instrument.waveform.segment_time_s": "3.1e-4",
    "instrument.waveform.fft_length / sample_rate_hz": None,
    "instrument.optics.waist_radius_m": "0.02",
    "instrument.optics.beamlets": "19",
    "instrument.detection.looks": "2",
    "faults.0.from_s": None,
    "faults.0.tilt_mrad": None,
    "seed": "9",
    "duration_s": "13",
}
INSTEAD = {
    "instrument.waveform.fft_length / sample_rate_hz": {"instrument.waveform.fft_length": "65536"},
    "faults.0.from_s": {"faults": "[]"},
    "faults.0.tilt_mrad": {"faults.0.tilt_mrad": "[3, 2]"},
}


@pytest.mark.parametrize("key", OTHER_GEOMETRY)
def test_of_another_geometry_the_first_key_is_named(key, recorded):
    scenario = flown({**WAY, **INSTEAD.get(key, {key: OTHER_GEOMETRY[key]})})
    with pytest.raises(InputError, match=r"as (recorded )?in ") as refusal:
        build_model(scenario, recorded)
    assert refusal.value.key == key


def rewritten(source: Path, target: Path, change, compression: int = ZIP_STORED) -> Path:
    """A copy whose entries are changed by a function of name and bytes."""
    with ZipFile(source) as old, ZipFile(target, "w", compression) as new:
        for name in old.namelist():
            new.writestr(name, change(name, old.read(name)))
    return target


def test_a_file_that_was_cut_damaged_or_is_none_is_refused(recorded, tmp_path):
    whole = recorded.read_bytes()
    other = tmp_path / "other.npz"
    np.savez(other, range_m=np.zeros(3))
    flipped = bytearray(whole)
    flipped[whole.index(b"0.beamlets.range_m") + 500] ^= 1
    for content in (
        b"",
        b"nothing",
        whole[: len(whole) // 2],
        whole[:-1],
        other.read_bytes(),
        bytes(flipped),
    ):
        (tmp_path / "bad.npz").write_bytes(content)
        with pytest.raises(InputError, match="no recorded geometry, or a truncated or damaged file"):
            measured(flown(WAY), tmp_path / "bad.npz")
    with pytest.raises(InputError, match="no such file"):
        build_model(flown(WAY), tmp_path / "absent.npz")
    # A block of another shape would send the kernels beyond its end.
    swapped = rewritten(recorded, tmp_path / "swapped.npz",
                        lambda _, data: data.replace(b"(128, 4, 7)", b"(128, 7, 4)"))  # fmt: skip
    with pytest.raises(InputError, match="damaged"):
        measured(flown(WAY), swapped)
    newer = rewritten(recorded, tmp_path / "newer.npz", lambda _, data: data.replace(
        '"version": 4,'.encode("utf-32-le"), '"version": 5,'.encode("utf-32-le")))  # fmt: skip
    with pytest.raises(InputError, match=r"version: must be 4: record the geometry again .*got 5"):
        build_model(flown(WAY), newer)


def test_neither_ground_nor_trajectory_is_built(recorded, monkeypatch):
    scenario = flown(WAY)
    for name in ("build_ground", "build_trajectory"):
        monkeypatch.setattr(f"lidar_emu.beams.flight.{name}", None)
    model = build_model(scenario, recorded)
    next(measure_in_blocks(model))
    (reported,) = [d for d in model.plan.decisions if d.stage == "trajectory, ground, casting"]
    assert not reported.computed
    assert "300 shots of 4 beams, 7 rays each" in reported.how


def restated(source: Path, target: Path, about: str, compression: int = ZIP_STORED) -> Path:
    """A copy of a geometry with another entry `about`."""
    entry = io.BytesIO()
    np.lib.format.write_array(entry, np.array(about))
    return rewritten(
        source, target, lambda name, data: entry.getvalue() if name == "about.npy" else data, compression
    )


@pytest.mark.parametrize(
    ("key", "value"),
    [
        *((key, value) for key in ("block_shots", "shots", "beams", "beamlets") for value in (None, "x", 0, [], 1.5)),
        *((key, 10**number) for key in ("shots", "beams", "beamlets") for number in (9, 30)),
        *(("conditions", value) for value in (None, "x", 1, [])),
        *((None, text) for text in ("[" * 100_000, "[]", "{}", "", '{"format": "lidar-emu geometry"}')),
    ],
)  # fmt: skip
def test_what_no_flight_has_is_refused(key, value, recorded, tmp_path):
    """By a key, or by the whole statement."""
    about = json.loads(str(np.load(recorded)["about"]))
    text = value if key is None else json.dumps(about | {key: value})
    with pytest.raises(InputError, match="no recorded geometry, or a truncated or damaged file"):
        measured(flown(WAY), restated(recorded, tmp_path / "bad.npz", text))


def test_a_compressed_entry_is_not_unpacked(recorded, tmp_path):
    """Megabytes of an archive may hold gigabytes."""
    bomb = restated(recorded, tmp_path / "bad.npz", " " * 20_000_000, ZIP_DEFLATED)
    tracemalloc.start()
    try:
        with pytest.raises(InputError, match="damaged file"):
            measured(flown(WAY), bomb)
        assert tracemalloc.get_traced_memory()[1] < 20_000_000
    finally:
        tracemalloc.stop()
