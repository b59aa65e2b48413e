"""Synthetic twins of the public files that the tests read: same names, formats and key figures, other contents.

Made without the project's own code. `write_all(folder)` lays them out as the folder named by LIDAR_EMU_REAL_DATA does.
"""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

ARISTARCHUS = "terrain/moon_aristarchus_imp_4p76m.tif"
HERODOTUS = "terrain/moon_herodotus_mons_53p6m.tif"
MOLA = "terrain/megt90n000cb.lbl"
ITOKAWA = "smallbody/itokawa_hayabusa_49152.obj"
APOLLO = "trajectory/apollo11_descent_clean.csv"
NEW_SHEPARD = "lidar/ns13_boddl_commercial_lidar.csv"
NEW_SHEPARD_GEOMETRY = "lidar/ns13_boddl_geometry.json"


def write_all(folder: Path) -> None:
    """Write every file below `folder`."""
    for name in (ARISTARCHUS, HERODOTUS, MOLA, ITOKAWA, APOLLO, NEW_SHEPARD):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
    write_aristarchus(folder / ARISTARCHUS)
    write_herodotus(folder / HERODOTUS)
    write_mars(folder / MOLA)
    write_small_body(folder / ITOKAWA)
    write_powered_descent(folder / APOLLO)
    write_lidar_flight(folder / NEW_SHEPARD, folder / NEW_SHEPARD_GEOMETRY)


def between(values: Floats, lowest: float, highest: float) -> Floats:
    """`values`, scaled so that they reach from `lowest` to `highest`."""
    return lowest + (highest - lowest) * (values - values.min()) / np.ptp(values)


def waves(east: Floats, north: Floats, seed: int, count: int) -> Floats:
    """A sum of waves of random direction and phase; the longest crosses the unit square once, amplitude ~ length."""
    rng = np.random.default_rng(seed)
    total = np.zeros(np.broadcast_shapes(east.shape, north.shape))
    for cycles in 1.5 ** np.arange(count):
        around, phase = rng.uniform(0, 2 * np.pi, 2)
        along = east * np.cos(around) + north * np.sin(around)
        total += np.sin(2 * np.pi * cycles * along + phase) / cycles
    return total


def map_grid(rows: int, columns: int) -> tuple[Floats, Floats]:
    """East and north of the samples, from -0.5 to 0.5 over the columns; rows count from the north."""
    east = (np.arange(columns) - (columns - 1) / 2) / columns
    north = ((rows - 1) / 2 - np.arange(rows)) / columns
    return east[None, :], north[:, None]


def write_aristarchus(path: Path) -> None:
    """A rough mare, elevation in the first band."""
    east, north = map_grid(237, 256)
    relief = between(1.3 * east + 0.6 * north + 0.25 * waves(east, north, 1, 8), -1393.27, -1297.31)
    write_moon_map(path, (25.047646, -46.76548), 4.764721, relief, elevation_band=1)


def write_herodotus(path: Path) -> None:
    """A mountain beside the middle of the map, elevation in the second band."""
    east, north = map_grid(191, 256)
    mountain = np.exp(-((east + 0.18) ** 2 + (north - 0.05) ** 2) / 0.02)
    relief = between(mountain + 0.06 * waves(east, north, 2, 7), -1684.63, -297.43)
    write_moon_map(path, (27.489461, -52.957024), 53.634071, relief, elevation_band=2)


def write_moon_map(
    path: Path, centre_deg: tuple[float, float], pixel_m: float, elevation_m: Floats, elevation_band: int
) -> None:
    """GeoTIFF on an orthographic plane that touches the Moon at the map's centre: elevation, slope, rock abundance."""
    import rasterio

    rows, columns = elevation_m.shape
    slope_deg = np.degrees(np.arctan(np.hypot(*np.gradient(elevation_m, pixel_m))))
    bands = [("qts_demstack", elevation_m), ("qts_demstack_slope", slope_deg)]
    bands = bands if elevation_band == 1 else bands[::-1]
    bands.append(("dlre_ra", between(waves(*map_grid(rows, columns), 3, 3), 0.002, 0.004)))
    latitude_deg, longitude_deg = centre_deg
    with rasterio.open(
        path, "w", driver="GTiff", dtype="float32", count=3, height=rows, width=columns, nodata=-np.inf,
        crs=f"+proj=ortho +lat_0={latitude_deg} +lon_0={longitude_deg} +R=1737400 +units=m +no_defs",
        transform=(pixel_m, 0, -columns / 2 * pixel_m, 0, -pixel_m, rows / 2 * pixel_m),
    ) as file:  # fmt: skip
        for number, (name, values) in enumerate(bands, start=1):
            file.write(values.astype(np.float32), number)
            file.set_band_description(number, name)


PDS_LABEL = """PDS_VERSION_ID = PDS3
RECORD_TYPE = FIXED_LENGTH
FILE_RECORDS = {lines}
RECORD_BYTES = {record_bytes}
^IMAGE = "{image}"
DATA_SET_ID = "{data_set}"
TARGET_NAME = MARS
OBJECT = IMAGE
  LINES = {lines}
  LINE_SAMPLES = {samples}
  SAMPLE_TYPE = {sample_type}
  SAMPLE_BITS = 16
  UNIT = {unit}
  SCALING_FACTOR = {scale}
  OFFSET = {offset}
END_OBJECT = IMAGE
OBJECT = IMAGE_MAP_PROJECTION
  MAP_PROJECTION_TYPE = "SIMPLE CYLINDRICAL"
  A_AXIS_RADIUS = {radius_km} <KM>
  B_AXIS_RADIUS = {radius_km} <KM>
  C_AXIS_RADIUS = {radius_km} <KM>
  POSITIVE_LONGITUDE_DIRECTION = "EAST"
  CENTER_LATITUDE = 0.0 <DEGREE>
  CENTER_LONGITUDE = 180.0 <DEGREE>
  MAP_RESOLUTION = {per_degree} <PIXEL/DEGREE>
  MAP_SCALE = {scale_km} <KM/PIXEL>
  LINE_PROJECTION_OFFSET = {line_offset}
  SAMPLE_PROJECTION_OFFSET = {sample_offset}
END_OBJECT = IMAGE_MAP_PROJECTION
END
"""


def pds_label(
    image: str,
    per_degree: int = 1,
    data_set: str = "MGS-M-MOLA-5-MEGDR-L3-V1.0",
    sample_type: str = "MSB_INTEGER",
    unit: str = "METER",
    scale: float = 1,
    offset: int = 0,
    radius_km: float = 3396.0,
    counted_from: float = 0.5,
) -> str:
    """The label of a map of a whole body in 16 bits; its first sample's centre is at `counted_from` less one half."""
    lines, samples = 180 * per_degree, 360 * per_degree
    places = {"line_offset": lines / 2 + counted_from, "sample_offset": samples / 2 + counted_from}
    size = {"lines": lines, "samples": samples, "record_bytes": 2 * samples, "per_degree": per_degree}
    return PDS_LABEL.format(
        image=image, data_set=data_set, sample_type=sample_type, unit=unit, scale=scale, offset=offset,
        radius_km=radius_km, scale_km=radius_km * np.pi / 180 / per_degree, **size, **places,
    )  # fmt: skip


MARS_PLACES = [
    # latitude and longitude, degrees; height above the surroundings, m; width, degrees
    (-32.79, 62.14, -8000, 8.0),  # Hellas
    (17.3, 226.9, 20900, 4.0),  # Olympus Mons
    (90.0, 0.0, -2000, 8.0),
    (-90.0, 0.0, 3000, 8.0),
]


def write_mars(path: Path) -> None:
    """A label and its image: a level planet with a basin, a mountain and two caps where the highest of Mars lie."""
    latitude = np.radians(90 - (np.arange(720) + 0.5) / 4)[:, None]
    longitude = np.radians((np.arange(1440) + 0.5) / 4)[None, :]
    height_m = 50 * np.sin(9 * longitude) * np.cos(latitude) ** 2
    for latitude_deg, longitude_deg, above_m, width_deg in MARS_PLACES:
        there = np.radians(latitude_deg)
        cosine = np.sin(latitude) * np.sin(there) + np.cos(latitude) * np.cos(there) * np.cos(
            longitude - np.radians(longitude_deg)
        )
        distance_deg = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
        height_m = height_m + above_m * np.exp(-((distance_deg / width_deg) ** 2))
    image = path.with_suffix(".img")
    image.write_bytes(np.rint(height_m).astype(">i2").tobytes())
    path.write_text(pds_label(image.name, per_degree=4))


def write_haworth(path: Path) -> None:
    """The format of the LOLA maps of 5 m: heights above 1737.4 km, polar stereographic, around 87.2 S, 5 W."""
    import rasterio

    samples, pixel_m, from_pole_m = 1400, 5.0, 2 * 1_737_400 * np.tan(np.radians(2.8) / 2)
    left_m = from_pole_m * np.sin(np.radians(-5)) - samples / 2 * pixel_m
    top_m = from_pole_m * np.cos(np.radians(-5)) + samples / 2 * pixel_m
    relief_m = between(waves(*map_grid(samples, samples), 4, 8), -3000, -1500)
    with rasterio.open(
        path, "w", driver="GTiff", dtype="float32", count=1, height=samples, width=samples,
        crs="+proj=stere +lat_0=-90 +lon_0=0 +R=1737400 +units=m +no_defs",
        transform=(pixel_m, 0, left_m, 0, -pixel_m, top_m),
    ) as file:  # fmt: skip
        file.write(relief_m.astype(np.float32), 1)


HIRISE_LABEL = """\
PDS_VERSION_ID = PDS3
RECORD_TYPE = FIXED_LENGTH
RECORD_BYTES = {record_bytes}
FILE_RECORDS = {records}
LABEL_RECORDS = 1
^IMAGE = 2
OBJECT = IMAGE_MAP_PROJECTION
  MAP_PROJECTION_TYPE = "EQUIRECTANGULAR"
  A_AXIS_RADIUS = 3396.19 <KM>
  B_AXIS_RADIUS = 3396.19 <KM>
  C_AXIS_RADIUS = 3396.19 <KM>
  COORDINATE_SYSTEM_NAME = PLANETOCENTRIC
  POSITIVE_LONGITUDE_DIRECTION = EAST
  CENTER_LATITUDE = 15.0 <DEG>
  CENTER_LONGITUDE = 180.0 <DEG>
  MAP_SCALE = 1.0 <METERS/PIXEL>
  LINE_PROJECTION_OFFSET = {line_offset}
  SAMPLE_PROJECTION_OFFSET = {sample_offset}
END_OBJECT = IMAGE_MAP_PROJECTION
OBJECT = IMAGE
  LINES = {samples}
  LINE_SAMPLES = {samples}
  BANDS = 1
  SAMPLE_TYPE = PC_REAL
  SAMPLE_BITS = 32
  MISSING_CONSTANT = 16#FF7FFFFB#
END_OBJECT = IMAGE
END
"""


def write_jezero(path: Path) -> None:
    """The format of HiRISE's elevation maps: one file of label and image, equirectangular, around 18.45 N, 77.44 E."""
    samples, radius_m = 1200, 3_396_190
    label = HIRISE_LABEL.format(
        samples=samples,
        records=samples + 1,
        record_bytes=4 * samples,
        line_offset=radius_m * np.radians(18.45) + samples / 2,
        sample_offset=radius_m * np.radians(180 - 77.44) * np.cos(np.radians(15)) + samples / 2,
    )
    relief_m = between(waves(*map_grid(samples, samples), 5, 8), -2600, -2550)
    path.write_bytes(label.encode().ljust(4 * samples) + relief_m.astype("<f4").tobytes())


def write_small_body(path: Path) -> None:
    """A bent, bumpy ellipsoid of 49152 triangles in km, whose six patches repeat the vertices along their edges."""
    steps = np.tan(np.linspace(-np.pi / 4, np.pi / 4, 65))
    first, second = np.meshgrid(steps, steps, indexing="ij")
    patches, faces = [], []
    corner = np.arange(65 * 65).reshape(65, 65)
    quads = [corner[:-1, :-1], corner[1:, :-1], corner[1:, 1:], corner[:-1, 1:]]
    for axis in range(3):
        for sign in (1.0, -1.0):
            cube = np.empty((65, 65, 3))
            cube[..., axis], cube[..., (axis + 1) % 3], cube[..., (axis + 2) % 3] = sign, sign * first, second
            a, b, c, d = (quad.ravel() + len(patches) * 65 * 65 for quad in quads)
            patches.append(cube.reshape(-1, 3))
            faces += [np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)]
    face = np.concatenate(faces)
    direction = np.concatenate(patches)
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    x, y, z = direction.T
    bumps = 1 + 0.04 * np.sin(5 * x + 2 * y) * np.cos(4 * z) + 0.02 * np.cos(11 * y - 7 * z)
    vertex = bumps[:, None] * direction * [0.27, 0.15, 0.12]
    vertex[:, 2] += 0.2 * vertex[:, 0] ** 2
    vertex *= (0.017786 / volume(vertex[face])) ** (1 / 3)
    with path.open("w") as file:
        file.writelines(f"v {a:.6f} {b:.6f} {c:.6f}\n" for a, b, c in vertex)
        file.writelines(f"f {a} {b} {c}\n" for a, b, c in face + 1)


def volume(corner: Floats) -> float:
    """Of a closed body, from its triangles (n, 3 corners, 3): the sum of the tetrahedra over them."""
    return float(np.linalg.det(corner).sum() / 6)


DESCENT_RATE = np.array([
    # time from contact, s; rate of climb, m/s
    (-755, -0.671), (-600, -10.0), (-465, -32.827), (-311, -41.575), (-277, -40.965), (-245, -37.003),
    (-191, -16.276), (-159, -7.650), (-139, -3.048), (-115, -1.0), (-45, -0.6), (3, -0.05),
])  # fmt: skip
PITCH = np.array(
    [(-465, 78.93), (-343, 62.0), (-245, 51.7), (-191, 32.15), (-159, 20.3), (-141, 5.2), (3, 2.0)]
)
GAPS_S = [
    (-749, -697), (-667, -645), (-637, -623), (-577, -523), (-483, -471), (-455, -343), (-277, -265), (-207, -195),
    (-191, -159),
]  # fmt: skip
MISSED_S = {
    -683, -681, -679, -677, -673, -605, -591, -589, -585, -581, -519, -517, -513, -511,
    -509, -507, -499, -497, -491, -489, -487, -485, -315, -313, -305, -303, -301, -237, -223, -221, -219,
    -213, -209, -193, -45,
}  # fmt: skip


def write_powered_descent(path: Path) -> None:
    """A row every two seconds, gaps and single misses aside, along a rate of climb of straight pieces."""
    with path.open("w", newline="") as stream:
        file = csv.writer(stream)
        file.writerow([
            "get_s", "t_touchdown_s", "agc_program", "agc_noun", "alt_m", "hdot_mps", "v_inertial_total_mps",
            "v_forward_mps", "pitch_from_vertical_deg", "lr_slant_range_m",
        ])  # fmt: skip
        for time_s in range(-755, 4, 2):
            if time_s in MISSED_S or any(begin < time_s < end for begin, end in GAPS_S):
                continue
            altitude_m, rate_mps = descent(time_s)
            program = 63 if time_s < -251 else 64 if time_s < -139 else 66
            pitch_deg = f"{np.interp(time_s, *PITCH.T):.2f}" if -465 <= time_s <= -1 else ""
            file.writerow([
                369940 + time_s, time_s, program, 60 if program == 66 else program, f"{altitude_m:.2f}",
                f"{rate_mps:.3f}", f"{-2.25 * time_s:.2f}" if program == 63 else "", "", pitch_deg, "",
            ])  # fmt: skip


def descent(time_s: float) -> tuple[float, float]:
    """Altitude, 3.05 m at the end, and rate of climb."""
    rate_mps = float(np.interp(time_s, *DESCENT_RATE.T))
    later = DESCENT_RATE[DESCENT_RATE[:, 0] > time_s]
    times_s, rates_mps = np.append(time_s, later[:, 0]), np.append(rate_mps, later[:, 1])
    climbed_m = np.sum(np.diff(times_s) * (rates_mps[1:] + rates_mps[:-1]) / 2)
    return 3.05 - float(climbed_m), rate_mps


def write_lidar_flight(path: Path, geometry: Path) -> None:
    """Ten seconds of a four-beam lidar straight down, at 10 Hz: Doppler noise with the tails of Student's t.

    Of the beams' own noise the geometry states less than what is in the rows, as for the flight.
    """
    beams = np.array([
        [-0.2998, -0.3996, -0.8663], [0.081, -0.49, -0.868], [0.1178, -0.7326, -0.6703], [0.4192, -0.2778, -0.8643],
    ])  # fmt: skip
    sigma_mps = np.array([0.15, 0.11, 0.33, 0.12])
    rng = np.random.default_rng(13)
    time_s = np.arange(4326, 4470) / 10
    velocity_mps = np.stack(
        [0 * time_s, 0 * time_s, np.interp(time_s, [432, 436, 447], [-30, -3, -3])], axis=1
    )
    scatter_mps = 1.3 * sigma_mps * rng.standard_t(4, size=(len(time_s), 4))
    speed_mps = np.clip(np.round((velocity_mps @ beams.T + scatter_mps) * 256) / 256, -45.61, 28.94)
    range_m = np.round(16 * (20 + (447 - time_s[:, None]) * 3 / -beams[:, 2])) / 16
    rows = np.column_stack([1_602_596_210_210_000_000 + np.rint(time_s * 1e9), range_m, speed_mps])
    names = [f"{name}[{k}]" for name in ("OMPS_Range_M", "OMPS_DopplerSpeed_MpS") for k in (1, 2, 3, 4)]
    np.savetxt(path, rows, fmt=["%.14e", *["%.8f"] * 8], delimiter=",", comments="",
               header=" ,".join(["TIME_NANOSECONDS_TAI", *names]))  # fmt: skip
    noise: dict[str, Any] = {"doppler_robust_sigma_mps": sigma_mps.tolist()}
    reported = {"beam_los_in_CON": beams.tolist(), "observed_in_the_csv": {"noise_436p5_to_447s": noise}}
    geometry.write_text(json.dumps(reported, indent=1))
