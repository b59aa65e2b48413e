"""What moves under the beams: its own velocity in everything that is measured of it."""

from __future__ import annotations

import numpy as np

from lidar_emu.api import simulate
from lidar_emu.beams.flight import Flight
from lidar_emu.beams.pointing import BeamVectors
from lidar_emu.numerics.vector_arrays import dot
from lidar_emu.plan.flight import plan_flight
from lidar_emu.receiver.echoes import compute_echoes
from lidar_emu.receiver.returns import Echoes

PAD = {"name": "deck", "kind": "pad", "diameter_m": 2000, "height_m": 2, "up_m": 0}
TILT = {"attitude": {"roll_deg": 3, "pitch_deg": 2, "yaw_deg": 30, "body_rate_radps": [0.02, 0.05, -0.02]}}


def descent(objects: list[dict], level: str = "spectral") -> dict:
    ways = [{"altitude_m": 150, "speed_mps": 30}, {"altitude_m": 50, "speed_mps": 5}]
    return {
        "level": level,
        "trajectory": {"kind": "profile", "path_angle_deg": 60, "waypoints": ways, **TILT},
        "site": {"ground": {"kind": "plane"}, "surface": {"reflectance": 0.3}, "objects": objects},
    }


def moving(velocity_mps: list[float], **keys: object) -> dict:
    return PAD | keys | {"motion": {"velocity_mps": velocity_mps}}


def test_at_one_instant_it_does_not_matter_which_of_the_two_moves(make_flight) -> None:
    """A deck that moves by v is seen as one at rest is from a sensor that moves by -v more."""
    velocity_mps = np.array([7.0, -4.0, 2.0])
    shot = np.array([0])
    scenario = make_flight(**descent([moving(velocity_mps.tolist())]))
    flight = Flight(scenario)
    pointing, _ = flight.point(shot, flight.scanner.initial)
    at_rest = Flight(make_flight(**descent([moving([0.0, 0.0, 0.0])])))
    beams = pointing.beams.copy()
    beams[BeamVectors._fields.index("velocity_mps")] -= velocity_mps
    # The first instants lie within a millisecond of the start, when both decks are at one place.
    pointing.time_ns[:] = 0
    seen = []
    for over, where in ((flight, pointing), (at_rest, pointing._replace(beams=beams))):
        hits = over.cast(where)
        assert (hits.object_id == 1).all()
        seen.append(compute_echoes(scenario.instrument, scenario.site, over, 19, where, hits))
    # The air moves with neither.
    seen = [echoes._replace(air_speed_mps=np.zeros(0)) for echoes in seen]
    for name, one, other in zip(Echoes._fields, *seen, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-12, atol=1e-11, err_msg=name)


def test_the_closing_speed_is_that_of_both(make_flight) -> None:
    velocity_mps = np.array([5.0, 3.0, 1.5])
    run = simulate(make_flight(**descent([moving(velocity_mps.tolist())], level="geometric")))
    still = simulate(make_flight(**descent([PAD], level="geometric")))
    axis = (run.point_site_m - run.position_site_m[:, None]) / run.range_m[..., None]
    np.testing.assert_allclose(
        run.closing_speed_mps, still.closing_speed_mps - dot(velocity_mps, axis), rtol=0, atol=1e-9
    )
    np.testing.assert_allclose(run.true_closing_speed_mps, run.closing_speed_mps, rtol=0, atol=1e-12)
    # It rises: each range is shorter by what it has risen, over the cosine of its beam.
    risen_m = velocity_mps[2] * run.time_ns * 1e-9
    np.testing.assert_allclose(still.range_m - run.range_m, risen_m / -axis[..., 2], rtol=0, atol=1e-9)


def test_chirps_meet_the_ground_where_it_has_moved_to() -> None:
    """A deck that rises at 10 m/s towards 20 m/s is, from chirp to chirp, one at rest under 30 m/s."""
    runs = []
    for speed_mps, rise_mps in ((20.0, 10.0), (30.0, 0.0)):
        ways = [
            {"altitude_m": altitude_m, "speed_mps": speed_mps} for altitude_m in (150.0, 150.0 - speed_mps)
        ]
        changes = {
            "site": {"base": "flat", "objects": [moving([0.0, 0.0, rise_mps])]},
            "instrument": {
                "base": "ndl_fine",
                "optics": {"speckle": False},
                "detection": {"combine": "chirp_minus_doppler"},
            },
            "trajectory": {"kind": "profile", "waypoints": ways},
        }
        runs.append(simulate("descent", changes))
    for name in ("range_m", "closing_speed_mps", "residual_mps", "snr_db"):
        np.testing.assert_allclose(*(getattr(run, name) for run in runs), rtol=0, atol=1e-6, err_msg=name)


def test_objects_out_of_reach_are_left_out_and_nothing_is_missed(make_flight, monkeypatch) -> None:
    from lidar_emu.scene.ray_reach import CroppedGround

    rocks = {"name": "rocks", "kind": "boulder", "diameter_m": 3, "scatter": {"count": 500, "radius_m": 600}}
    scenario = make_flight(**descent([rocks, moving([3.0, 0.0, 0.0], diameter_m=60)]))
    cut = simulate(scenario)
    scene = Flight(scenario).scene.still
    assert isinstance(scene, CroppedGround)
    (kept,) = scene.grids
    assert kept.samples == 500 * 320
    assert 0 < kept.retained < kept.samples / 2
    reported = {row["stage"]: row["how"] for row in plan_flight(scenario, Flight(scenario)).rows()}
    assert reported["objects out of reach"] == f"{kept.retained} of 160000 triangles in memory"
    # Rays elsewhere hit them there.
    origin = np.column_stack([np.random.default_rng(1).uniform(-600, 600, (2000, 2)), np.full(2000, 50.0)])
    down = np.broadcast_to([0.0, 0.0, -1.0], origin.shape)
    monkeypatch.setattr("lidar_emu.scene.objects.build.CUT_FROM_TRIANGLES", 10**9)
    uncut = Flight(scenario).scene
    np.testing.assert_array_equal(
        scene.cast(origin, down).object_id, uncut.still.cast(origin, down).object_id
    )
    np.testing.assert_array_equal(scene.height_m(*origin.T[:2]), uncut.still.height_m(*origin.T[:2]))
    whole = simulate(scenario)
    for name in ("range_m", "closing_speed_mps", "snr_db"):
        np.testing.assert_array_equal(getattr(cut, name), getattr(whole, name))
