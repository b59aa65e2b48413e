"""Scenario files that cannot be used, each broken in one place."""

from __future__ import annotations

from itertools import pairwise

from bad_case import BENCH, FLIGHT, SIMULATE, SITE, Case, changed


def _nested(first: str, again: str) -> str:
    """Ten of ten of ten, nine times over."""
    lines = [f"{new}: &{new} {again % ', '.join(10 * [f'*{old}'])}" for old, new in pairwise("abcdefghi")]
    return "\n".join([f"a: &a {first}", *lines])


_DOCUMENTS: list[tuple[str, str | bytes, tuple[str, ...]]] = [
    ("an empty file", "", ("an empty file", "state a mapping")),
    ("comments only", "# nothing yet\n", ("an empty file", "state a mapping")),
    ("a list", "[1, 2]", ("my.yaml: a list; state a mapping",)),
    ("a word, which is not shown", "secret", ("my.yaml: text; state a mapping",)),
    ("not YAML", "name: hop\n- {a: [\n", ("line 2", "write YAML 1.2")),
    ("two documents", f"{FLIGHT}---\n{FLIGHT}", ("a single document", "write YAML 1.2")),
    ("not UTF-8", b"name: \xff\xfe\n", ("not UTF-8 text", "use a YAML file")),
    ("control characters", bytes(range(8)) * 4, ("special characters", "write YAML 1.2")),
    ("too large", "#" * 1_000_002, ("1000002 bytes", "the limit is 1000000 bytes")),
    ("duplicate key", "name: one\nname: two\n", ("line 2", '"name"', '"two"', "state each key once")),
    (
        "no space after a colon",
        "faults: [{kind:dropout}]\n",
        ("faults.0: must have a space after the colon",),
    ),
    ("a recording", b"\x89MCAP0\r\n", ("my.yaml: a recording; lidar-emu report, replay or view takes it",)),
    ("key of an object", "? [1, 2]\n: 3\n", ("[1, 2]", "must be text, as a key")),
    ("tag of a program", "name: !!python/object:os.system ls\n", ("line 1", "os.system", "write YAML 1.2")),
    ("tag of bytes", "name: !!binary aGVsbG8=\n", ("name", "hello", "must be text, a number")),
    ("tag that does not fit", "seed: !!bool perhaps\n", ("perhaps", "write YAML 1.2")),
    ("half a surrogate", 'name: "\\ud800"\n', ("name", "d800", "must be text")),
    ("alias bomb", _nested("[x, x, x, x]", "[%s]"), ("repeated", "use at most 100000 values")),
    ("merge bomb", _nested("{p: 1, q: 2}", "{<<: [%s]}"), ("merged too many keys", "write YAML 1.2")),
    ("alias recursion", "a: &a [*a]\n", ("nested", "32 deep")),
    ("alias recursion in a mapping", "a: &a {b: *a}\n", ("nested", "32 deep")),
    ("deep nesting", "a: " + 1000 * "[", ("nested too deeply", "nest at most 32 deep")),
]

_KEYS: list[tuple[str, str, str, tuple[str, ...]]] = [
    ("unknown key", "name: hop", "name: hop\ncolour: red", ("colour: no such key; known here: ", "timing")),
    ("a key as of --set", "name: hop", "name: hop\ntiming.rate_hz: 5", ("nest it, as timing: {rate_hz: ...}",)),
    ("unknown key below", "rate_hz: 20", "rate: 5",
     ("timing.rate: no such key; did you mean timing.rate_hz? known here: rate_hz",)),
    ("key of another part", "beamlets: 1", "wavelength_m: 1e-6",
     ("optics.wavelength_m: no such key; did you mean instrument.waveform.wavelength_m? known here: laser_power_w",)),
    ("unknown part of a part", "optics: {beamlets: 1}", "laser: {linewidth_hz: 1e4}",
     ("instrument.laser: no such key; did you mean instrument.waveform.linewidth_hz? known here: ",)),
    ("key of other kinds alone", "name: hop", "name: hop\nfile: a.tif", ("my.yaml: file: no such key; known here: ",)),
    ("key of another kind", "slope_deg: 1", "file: dem.tif",
     ("site.ground.file: no such key; a key of kind grid or mesh, not plane; known here: kind, slope_deg, ",)),
    ("misspelled kind", "kind: plane", "kind: plain",
     ("site.ground.kind: did you mean plane? must be plane, sphere, grid", "(got 'plain')")),
    ("misspelled key of a kind", "kind: plane", "knid: plane",
     ("site.ground.kind: missing; rename knid, or choose plane, ",)),
    ("no file", "{kind: plane, slope_deg: 1}", "{kind: mesh, unit: m}", ("file: missing; this key is required\n",)),
    ("key of a mapping around", "{kind: plane, slope_deg: 1}", "{kind: grid, file: a.tif, origin: {file: b}}",
     ("site.ground.origin.file: no such key; did you mean site.ground.file?",)),
    ("no unit", "{kind: plane, slope_deg: 1}", "{kind: mesh, file: a.ply}",
     ("site.ground.unit: missing; this key is required: m or km",)),
    ("unknown key of a kind", "slope_deg: 1", "slope: 2", ("site.ground.slope: no such key", "kind, slope_deg")),
    ("number as key", "rate_hz: 20", "5: 20", ("timing: must be ", "(got 5", "must be text, as a key")),
    ("unknown kind", "kind: plane", "kind: cone", ("site.ground.kind: must be ", "(got 'cone'", "plane, sphere, grid")),
    ("no kind", "kind: plane, ", "", ("site.ground.kind: missing", "plane, sphere, grid")),
    ("wrong unit", "altitude_m: 200", "altitude_km: 2",
     ("trajectory.waypoints.0.altitude_km: no such key; did you mean trajectory.waypoints.0.altitude_m (2000 here)?",)),
    ("missing key", ", speed_mps: 10", "",
     ("trajectory.waypoints.1.speed_mps: missing; this key is required, e.g. speed_mps: 100",)),
    ("missing part", SITE, "", ("site: missing; this key is required, e.g. site: mare",)),
    ("misspelled part", SITE, "site: marre", ("site: no such file: 'marre'; did you mean mare? name a file",)),
    ("unknown part", SITE, "site: venus", ("site: no such file: 'venus'", "flat, mare")),
    ("unknown base", SITE, "site: {base: venus}", ("site: no such file: 'venus'", "flat, mare")),
    ("number as base", SITE, "site: {base: 3}", ("site.base: must be ", "(got 3", "must be the name of a file")),
    ("name with NUL", SITE, 'site: "a\\0b"', ("site: must be ", "(got 'a\\x00b'", "must be text")),
    ("name too long", SITE, f"site: {300 * 'x'}", ("site: no such file: 'xxx", "flat, mare")),
    ("number for a part", SITE, "site: 7",
     ("site: must be ", "(got 7", "must be a mapping of keys to values, or the name")),
    ("a base's replaced value", SITE, "site: {base: flat, surface: {reflectance: 2}}",
     ("site.surface.reflectance: must be ", "(got 2", "less than or equal to 1")),
    ("a key beside a base", SITE, "site: {base: flat, surfce: {reflectance: 0.2}}",
     ("site.surfce: no such key; did you mean site.surface?",)),
    ("a key below a base's other kind", SITE, "site: {base: flat, ground: {kind: grid}}",
     ("site.ground.file: missing; this key is required, e.g. file: ",)),
    ("a mapping in place of a base's number", SITE, "site: {base: flat, surface: {reflectance: {}}}",
     ("site.surface.reflectance: must be a number",)),
    ("a mapping in place of a base's text", SITE, "site: {base: flat, name: {first: 1}}", ("site.name: must be text",)),
    ("a value that does not go with the base's", FLIGHT[FLIGHT.index("instrument:"):FLIGHT.index("site:")],
     "instrument: {base: ndl_four_beam, waveform: {segment_time_s: 1e-4}}\n",
     ("instrument.waveform.fft_length: must be at most 60000, the samples in segment_time_s; ndl_four_beam.yaml "
      "states it (got 131072)",)),
]  # fmt: skip

_NUMBERS: list[tuple[str, str, str, tuple[str, ...]]] = [
    ("negative altitude", "altitude_m: 100", "altitude_m: -3",
     ("trajectory.waypoints.1.altitude_m: must be greater than or equal to 0 (got -3)",)),
    ("NaN", "duration_s: 5", "duration_s: .nan", ("duration_s: must be ", "(got nan", "a finite number")),
    ("nan as text", "duration_s: 5", "duration_s: nan", ("duration_s: must be ", "(got 'nan'", "a number")),
    ("an altitude beyond the Sun", "altitude_m: 200", "altitude_m: 1e300",
     ("trajectory.waypoints.0.altitude_m: must be ", "(got 1e+300", "less than or equal to 10000000")),
    ("a mounting beyond the Sun", "name: hop", "name: hop\nmounting: {lever_arm_m: [0, 1e300, 0]}",
     ("mounting.lever_arm_m: must be ", "(got [0", "must be at most 1e+09 m in magnitude")),
    ("a body beyond the Sun", "{kind: plane, slope_deg: 1}", "{kind: sphere}\n  body: {radius_m: 1e300}",
     ("site.body.radius_m: must be ", "(got 1e+300", "must be at most 1e+09 m in magnitude")),
    ("negative duration", "duration_s: 5", "duration_s: -5", ("duration_s: must be ", "(got -5", "greater than 0")),
    ("inf", "rate_hz: 20", "rate_hz: .inf", ("timing.rate_hz: must be ", "(got inf", "a finite number")),
    ("1e400", "rate_hz: 20", "rate_hz: 1e400", ("timing.rate_hz: must be ", "(got inf", "a finite number")),
    ("too many digits", "rate_hz: 20", f"rate_hz: 1{400 * '0'}", ("rate_hz: a number of 401 char", "at most 100")),
    ("far too many", "rate_hz: 20", f"rate_hz: 0x1{9000 * '0'}", ("rate_hz: a number of 9003 char", "at most 100")),
    ("20 digits", "rate_hz: 20", f"rate_hz: 1{20 * '0'}", ("timing.rate_hz: must be ", "(got 1000", "up to 18 digits")),
    ("true for a number", "rate_hz: 20", "rate_hz: true", ("timing.rate_hz: must be ", "(got true", "a number")),
    ("text for a number", "rate_hz: 20", "rate_hz: fast", ("timing.rate_hz: must be ", "(got 'fast'", "a number")),
    ("list for a number", "rate_hz: 20", "rate_hz: [20]", ("timing.rate_hz: must be ", "(got [20]", "a number")),
    ("number for text", "name: hop", "name: 5", ("name: must be ", "(got 5", "must be text")),
    ("fraction for a count", "name: hop", "name: hop\nseed: 1.5", ("seed: must be ", "(got 1.5", "a whole number")),
    ("exponent for a count", "131072", "1e5",
     ("instrument.waveform.fft_length: must be ", "(got 100000.0", "no point")),
    ("nothing for a mapping", "timing: {rate_hz: 20, epoch: 2030-01-01T00:00:00Z}", "timing:",
     ("timing: must be ", "(got null", "a mapping of keys to values")),
    ("mapping for a list", "waypoints:", "waypoints: {}\n  attic:",
     ("trajectory.waypoints: must be ", "(got {}", "a list")),
    ("no instant", "2030-01-01T00:00:00Z", "tomorrow",
     ("timing.epoch: must be ", "(got 'tomorrow'", "2030-01-01T12:00:00Z")),
    ("no such date", "2030-01-01T00", "2030-13-45T00", ("timing.epoch: must be ", "(got '2030-13-45T00", "an instant")),
    ("zero rate", "rate_hz: 20", "rate_hz: 0", ("timing.rate_hz: must be ", "(got 0)", "must be greater than")),
    ("unreachable rate", "rate_hz: 20", "rate_hz: 2000",
     ("timing.rate_hz: must be ", "(got 2000", "at most 1111.11", "together")),
    ("no waypoint", "waypoints:", "waypoints: []\n  attic:", ("trajectory.waypoints: a list of 0", "at least 2")),
    ("ascending", "altitude_m: 100", "altitude_m: 300", ("waypoints.1.altitude_m: must be ", "(got 300", "below 200")),
    ("standing still", "20}\n    - {altitude_m: 100, speed_mps: 10", "0}\n    - {altitude_m: 100, speed_mps: 0",
     ("trajectory.waypoints.1.speed_mps: must be ", "(got 0", "greater than 0")),
    ("beam angle 90", "angle_deg: 20", "angle_deg: 90",
     ("scanner.pattern.angle_deg: must be ", "(got 90", "less than 90")),
    ("beamlets 20", "beamlets: 1", "beamlets: 20", ("instrument.optics.beamlets: must be ", "(got 20", "1, 7, 19")),
    ("FFT of 1000", "131072", "1000", ("instrument.waveform.fft_length: must be ", "(got 1000", "a power of two")),
    ("record longer than segment", "131072", "262144",
     ("instrument.waveform.fft_length: must be ", "(got 262144", "at most 180000, the samples in segment_time_s")),
    ("beyond the record edge", "maximum_range_m: 12000", "maximum_range_m: 13000",
     ("instrument.detection.maximum_range_m: must be ", "(got 13000", "at most 12223.5")),
    ("segment too short for the range", "300e-6", "250e-6",
     ("instrument.detection.maximum_range_m: must be ", "(got 12000", "at most 4728.73")),
    ("gain", "responsivity_a_per_w: 1.0", "responsivity_a_per_w: 1.3",
     ("responsivity_a_per_w: must be ", "(got 1.3", "at most 1.25")),
    ("unknown window", "window: hann", "window: kaiser",
     ("instrument.detection.window: must be ", "(got 'kaiser'", "'hann'")),
    ("three misalignments", "firing: together", "misalignment_mrad: [[0, 1], [0, 1], [0, 1]]",
     ("scanner.misalignment_mrad: a list of 3", "4 entries")),
    ("half a misalignment", "firing: together", "misalignment_mrad: [[0]]",
     ("scanner.misalignment_mrad.0.1: missing", "required")),
    ("lever arm of four", "name: hop", "name: hop\nmounting: {lever_arm_m: [0, 0, 0, 0]}",
     ("mounting.lever_arm_m: a list of 4", "at most 3")),
    ("longer than the flight", "duration_s: 5", "duration_s: 100",
     ("duration_s: must be ", "(got 100", "at most 6.66667, the duration of the flight")),
]  # fmt: skip

_PATTERNS: list[tuple[str, str, str, tuple[str, ...]]] = [
    ("pattern and site", "name: bench", "name: bench\nsite: flat",
     ("site: given beside bench_pattern; state bench_pattern, or",)),
    ("negative range", "range_m: 100", "range_m: -100",
     ("beams.0.range_m: must be ", "(got -100", "greater than or equal to 0")),
    ("text for a level", "range_m: 100", "range_m: far", ("beams.0.range_m: must be ", "(got 'far'", "a number")),
    ("ramp below zero", "range_m: 100", "range_m: {start: 1, stop: -1, period_s: 1}",
     ("bench_pattern.beams.0.range_m.stop: must be ", "(got -1", "greater than or equal to 0")),
    ("ramp of nothing", "range_m: 100", "range_m: {begin: 1}",
     ("beams.0.range_m.begin: no such key", "start, stop, period_s")),
    ("no switch", "speed_mps: 5", "speed_mps: 5, valid: maybe",
     ("beams.0.valid: must be ", "(got 'maybe'", "on or off")),
]  # fmt: skip

_FAULTS: list[tuple[str, tuple[str, ...]]] = [
    ("{kind: dropout, at_s: 1, from_s: 2}", ("at_s: must be left out beside from_s and to_s (got 1)",)),
    ("{kind: dropout, from_s: 2, to_s: 2}", ("to_s: must be more than from_s, 2 (got 2)",)),
    ("{kind: disconnect, from_s: 2, to_s: 1}", ("to_s: must be more than from_s, 2 (got 1)",)),
    (
        "{kind: dropout, lasts_s: 1}",
        ("lasts_s: must be left out beside at_s, and with a probability of 1 (got 1)",),
    ),
    (
        "{kind: outlier, range_m: [2, 1]}",
        ("range_m: must be minimum and maximum, in this order (got [2, 1])",),
    ),
    ("{kind: swapped_beams, beams: [1, 1]}", ("beams: must be two different beams (got [1, 1])",)),
]
_GROUND = "{kind: plane, slope_deg: 1}"
_BETWEEN_KEYS = [
    (_GROUND, "{kind: grid, file: a.tif, origin: {map_x_m: 1}}",
     "map_y_m: missing; state map_x_m and map_y_m, or neither"),
    (_GROUND, "{kind: grid, file: a.tif, origin: {map_x_m: 1, map_y_m: 1, latitude_deg: 1, longitude_deg: 1}}",
     "map_x_m: must be left out beside latitude_deg, not both (got 1)"),
    (_GROUND, "{kind: mesh, file: a.ply, unit: m, origin: {latitude_deg: 1}}",
     "longitude_deg: missing; state latitude_deg and longitude_deg, or neither"),
    (_GROUND, _GROUND + "\n  objects: [{name: rock, kind: boulder, diameter_m: 1, scatter: "
     "{count: 2, radius_m: 9, scale: [2, 1]}}]", "scale: must be in order, the smallest size first (got [2, 1])"),
    ("window: hann", "window: hann, rule: any_two, combine: chirp_minus_doppler",
     "rule: must be all_three without combine: least_squares (got 'any_two')"),
]  # fmt: skip


def _in_part(name: str, text: str, *expected: str) -> Case:
    return Case(name, expected, {"my.yaml": changed(FLIGHT, SITE, "site: my_site"), "my_site.yaml": text})


CASES = [
    *(Case(name, ("my.yaml: ", *expected), {"my.yaml": text}) for name, text, expected in _DOCUMENTS),
    *(
        Case(name, ("my.yaml: ", *expected), {"my.yaml": changed(FLIGHT, old, new)})
        for name, old, new, expected in _KEYS
    ),
    *(Case(name, expected, {"my.yaml": changed(FLIGHT, old, new)}) for name, old, new, expected in _NUMBERS),
    *(
        Case(name, ("my.yaml: ", *expected), {"my.yaml": changed(BENCH, old, new)})
        for name, old, new, expected in _PATTERNS
    ),
    *(
        Case(text, ("my.yaml: faults.0.", *expected), {"my.yaml": f"{FLIGHT}faults: [{text}]\n"})
        for text, expected in _FAULTS
    ),
    *(Case(line, (line,), {"my.yaml": changed(FLIGHT, old, new)}) for old, new, line in _BETWEEN_KEYS),
    Case(
        "unreachable rate in turn",
        ("my.yaml: timing.rate_hz: must be ", "(got 300", "at most 277.778", "in turn"),
        {"my.yaml": changed(FLIGHT, "rate_hz: 20", "rate_hz: 300").replace("together", "in_turn")},
        f"{SIMULATE} --set wire.unit=3",
    ),
    _in_part(
        "unknown key in a part's file",
        "ground: {kind: plane, h: 3}",
        "my_site.yaml: ground.h: no such key",
        "slope_deg",
    ),
    _in_part(
        "another part's key in a part's file", "rate_hz: 3", "my_site.yaml: rate_hz: no such key; known here"
    ),
    _in_part(
        "values of a part's file that do not go together",
        "base: flat\nground: {kind: grid, file: a.tif, origin: {map_x_m: 1}}",
        "my_site.yaml: ground.origin.map_y_m: missing; state map_x_m and map_y_m, or neither\n",
    ),
    Case(
        "a descent without enough propellant",
        ("trajectory: vehicle.dry_mass_kg: out of propellant after", "shorten the flight"),
        command="simulate powered_descent.yaml --out out.csv --set trajectory.vehicle.dry_mass_kg=1480",
    ),
    Case(
        "a descent that begins below its gate",
        (
            "trajectory.start.position_site_m: must be ",
            "(got [0, 0, 20]",
            "a position above the gate, at 31.2",
        ),
        command="simulate powered_descent.yaml --out out.csv --set trajectory.start.position_site_m=[0,0,20]",
    ),
    _in_part("missing key in a part's file", "name: here", "my_site.yaml: ground: missing", "required"),
    _in_part("duplicate key in a part's file", "name: a\nname: b", "my_site.yaml: line 2", "each key once"),
    _in_part("an empty part's file", "", "my_site.yaml: an empty file", "a mapping"),
]
