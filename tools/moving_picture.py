"""Draw the moving picture of README from a recording of `powered_descent`.

    lidar-emu run powered_descent.yaml --pace max --record flight.mcap
    python tools/moving_picture.py flight.mcap docs/descent.webp
    python tools/moving_picture.py flight.mcap frame.png --time 30     # one frame

`lidar_emu.Ground` casts the ground of each frame, as it does for the beams. Beams, footprints, attitude and bytes are
the recording's; the read-outs are what `lidar_protocol` decodes from the bytes. Chosen for looks: the sun, the relief
below the map's 4 m and beyond the map, where the ground is level, the width of the beams, the lander's size above 25 m.
"""

from __future__ import annotations

import argparse
import colorsys
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib import get_data_path
from moon_view import HEIGHT, SUN, WIDTH, Camera, Moon
from PIL import Image, ImageChops, ImageColor, ImageDraw, ImageFilter, ImageFont
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation

import lidar_emu
from lidar_emu.report.beam_colours import BEAM_COLOURS
from lidar_protocol import Message, SerialReceiver, default_interface

SCALE = 2  # drawn larger, then reduced
START_S, SPEED_UP, FRAMES_PER_S, HOLD_MS = 7.7, 8, 12, 1200
QUALITY = 58  # of WebP: below 3 MB
SENSOR_M = 1.3  # above the feet
SPOT = np.array([11, 7])
TRAIL_SHOTS, GHOST_SHOTS, EVENT_SHOTS = 300, 80, 360
INK, DIM, GOLD = "#eef2f6", "#8b98a5", "#ffd166"
EDGE: dict[str, Any] = {"stroke_width": 3, "stroke_fill": "#06080c"}
FONTS = {"text": "DejaVuSans", "bold": "DejaVuSans-Bold", "mono": "DejaVuSansMono"}


def bright(colour: str) -> tuple[int, int, int]:
    """The colour of a beam as light: the same hue, lighter."""
    red, green, blue = (part / 255 for part in ImageColor.getrgb(colour)[:3])
    hue, lightness, saturation = colorsys.rgb_to_hls(red, green, blue)
    light = colorsys.hls_to_rgb(hue, max(lightness, 0.6), min(1.0, 1.15 * saturation))
    return tuple(round(255 * part) for part in light)  # type: ignore[return-value]


def dimmed(colour: tuple[int, ...], share: float) -> tuple[int, ...]:
    """A share of a light."""
    return tuple(round(share * part) for part in colour)


LIGHTS = [bright(colour) for colour in BEAM_COLOURS[:4]]


class Flight(NamedTuple):
    """What the recording holds, with one row per shot."""

    time_s: np.ndarray
    position_m: np.ndarray
    site_from_body: np.ndarray
    hit_m: np.ndarray
    angle_deg: np.ndarray
    payload: list[bytes]
    decoded: list[Message]


def read_flight(path: str) -> tuple[Any, Flight]:
    """The scenario and the flight of a recording of a serial line from which nothing is lost."""
    recording = lidar_emu.read_recording(path)
    if recording.scenario.name != "powered_descent":
        raise lidar_emu.InputError(path, "scenario", recording.scenario.name, "must be powered_descent")
    measured, payload = recording.measurement(), recording.packets().payload
    receiver = SerialReceiver(default_interface())
    decoded = [found for each in payload for found in receiver.receive(each) if isinstance(found, Message)]
    if len(decoded) != len(measured.shot):
        found = f"{len(decoded)} for {len(measured.shot)} shots"
        raise lidar_emu.InputError(path, "packets", found, "must be one per shot, of a serial line")
    truth = measured.truth
    flight = Flight(
        measured.time_s[:, 0],
        truth.position_site_m,
        truth.site_from_body,
        truth.point_site_m,
        measured.beam_angle_deg[:, 0],
        payload,
        decoded,
    )
    return recording.scenario, flight


def cameras(flight: Flight) -> list[Camera]:
    """A camera per shot: it follows lander and footprints without haste, and comes closer as they do."""
    foot_m = np.median(flight.hit_m, axis=1)
    aim_m = gaussian_filter1d(0.54 * flight.position_m + 0.46 * foot_m, 25, axis=0, mode="nearest")
    spread_m = np.linalg.norm(flight.hit_m - flight.position_m[:, None], axis=2).mean(axis=1)
    spread_m *= 1.72
    reach_m = np.exp(gaussian_filter1d(np.log(np.maximum(spread_m, 14.0)), 35, mode="nearest"))
    share = np.linspace(0, 1, len(reach_m))
    heading_deg, pitch_deg = 320 + 19 * share, 20 - 9 * share
    return [Camera.aimed(*each) for each in zip(aim_m, reach_m, heading_deg, pitch_deg, strict=True)]


def shot_before_switch(flight: Flight, shot: int, shots: int) -> int | None:
    """The last shot with another beam angle, if it is one of the last shots."""
    others = np.flatnonzero(flight.angle_deg[:shot] != flight.angle_deg[shot])
    return int(others[-1]) if len(others) and shot - others[-1] < shots else None


def prism(low: float, high: float, inner: float, outer: float, colour: str) -> list[tuple[np.ndarray, str]]:
    """Sides and lid of an octagonal prism that may taper."""
    turn = np.arange(8) * np.pi / 4 + np.pi / 8
    ring = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    bottom, top = np.c_[inner * ring, np.full(8, low)], np.c_[outer * ring, np.full(8, high)]
    sides = [np.stack([bottom[k - 1], bottom[k], top[k], top[k - 1]]) for k in range(8)]
    return [(face, colour) for face in [*sides, top, bottom[::-1]]]


def lander() -> list[tuple[np.ndarray, str]]:
    """Faces of a lander of 4 m, up along z from its feet, with their colours."""
    faces = prism(0.5, 0.95, 0.42, 0.2, "#6b6b70") + prism(0.95, 1.9, 1.25, 1.25, "#d9a441")
    faces += prism(1.9, 2.7, 0.95, 0.7, "#c9d0d6") + prism(2.7, 2.95, 0.3, 0.16, "#9aa4ad")
    for turn in np.pi / 4 * np.array([1, 3, 5, 7]):
        out, side = np.array([np.cos(turn), np.sin(turn), 0]), np.array([-np.sin(turn), np.cos(turn), 0])
        foot, up = 2.0 * out + [0, 0, 0.08], np.array([0, 0, 1.0])
        for knee in (1.15 * out + 1.7 * up, 1.15 * out + 0.95 * up):
            for wide in (0.07 * side, 0.07 * up):
                faces.append((np.stack([knee - wide, knee + wide, foot + wide, foot - wide]), "#aab2ba"))
        ring = [0.32 * (np.cos(a) * out + np.sin(a) * side) for a in np.arange(8) * np.pi / 4]
        faces.append((2.0 * out + np.array(ring), "#aab2ba"))
    return faces


@cache
def font_of(name: str, size: float) -> ImageFont.FreeTypeFont:
    """A font that matplotlib ships, by the size in pixels of the picture."""
    return ImageFont.truetype(f"{get_data_path()}/fonts/ttf/{FONTS[name]}.ttf", round(SCALE * size))


def write(draw: ImageDraw.ImageDraw, x: float, y: float, text: str, size: float, **how: Any) -> None:
    """Write text at a pixel of the picture."""
    font = font_of(how.pop("font", "text"), size)
    draw.text((SCALE * x, SCALE * y), text, font=font, fill=how.pop("fill", INK), **how)


def draw_lander(picture: Image.Image, camera: Camera, position_m: np.ndarray, matrix: np.ndarray) -> None:
    """The lander with its attitude, never smaller than can be seen, and its shadow on the ground when low."""
    draw = ImageDraw.Draw(picture, "RGBA")
    size = max(1.0, 0.024 * np.linalg.norm(position_m - camera.eye_m))
    axes = size * matrix @ np.diag([1.0, -1.0, -1.0])  # body z is down
    faces = [(position_m + (face - [0, 0, SENSOR_M]) @ axes.T, colour) for face, colour in lander()]
    if size == 1.0:
        for face, _ in faces:
            ground = face - face[:, 2:] / SUN[2] * SUN
            draw.polygon([tuple(p) for p in SCALE * camera.pixels(ground)], fill=(4, 5, 8, 235))
    for face, colour in sorted(faces, key=lambda each: -np.linalg.norm(each[0].mean(axis=0) - camera.eye_m)):
        normal = np.cross(face[1] - face[0], face[2] - face[1])
        normal /= np.linalg.norm(normal) + 1e-12
        light = 0.22 + 0.95 * max(0.0, float(normal @ SUN)) + 0.12 * abs(normal[2])
        shade = tuple(min(255, round(part * light)) for part in ImageColor.getrgb(colour)[:3])
        draw.polygon([tuple(p) for p in SCALE * camera.pixels(face)], fill=shade)


def add_light(picture: Image.Image, flight: Flight, shot: int, camera: Camera) -> Image.Image:
    """The picture with beams, footprints, the trails of these, and after a switch the beams before it."""
    sharp, wide, faint = (Image.new("RGB", picture.size) for _ in range(3))
    draw, glow, trails = (ImageDraw.Draw(each) for each in (sharp, wide, faint))
    start = tuple(SCALE * camera.pixels(flight.position_m[shot]))
    last = shot_before_switch(flight, shot, GHOST_SHOTS)
    for beam, colour in enumerate(LIGHTS):
        seen = SCALE * camera.pixels(flight.hit_m[: shot + 1, beam])
        draw_trail(trails, flight, seen, colour)
        end = seen[-1]
        if last is not None:
            faded = dimmed(colour, 0.5 * (1 - (shot - last) / GHOST_SHOTS))
            trails.line([start, tuple(seen[last])], fill=faded, width=4)
        if not flight.decoded[shot].beams[beam]["range_valid"]:
            trails.line([start, tuple(end)], fill=dimmed(colour, 0.25), width=3)
            continue
        draw.line([start, tuple(end)], fill=colour, width=5)
        draw.ellipse([*(end - SPOT), *(end + SPOT)], fill=colour)
        glow.line([start, tuple(end)], fill=colour, width=12)
        glow.ellipse([*(end - 18), *(end + 18)], fill=colour)
    wide = wide.filter(ImageFilter.GaussianBlur(8)).point(lambda part: 0.5 * part)
    picture = ImageChops.lighter(ImageChops.add(picture, faint), sharp)
    return ImageChops.add(picture, wide)


def draw_trail(
    draw: ImageDraw.ImageDraw, flight: Flight, seen: np.ndarray, colour: tuple[int, int, int]
) -> None:
    """Where a beam hit the ground in the last shots, brighter where it was later."""
    shot = len(seen) - 1
    for last in range(max(5, shot - TRAIL_SHOTS), shot + 1, 5):
        step = seen[last - 5 : last + 1 : 5]
        if np.isfinite(step).all() and flight.angle_deg[last] == flight.angle_deg[last - 5]:
            faded = dimmed(colour, 0.8 * (1 - (shot - last) / TRAIL_SHOTS))
            draw.line([tuple(p) for p in step], fill=faded, width=6)


def draw_panel(picture: Image.Image, flight: Flight, shot: int) -> None:
    """The packet as bytes, the cable, and what the flight computer reads."""
    draw = ImageDraw.Draw(picture, "RGBA")
    left, right = 480, 712
    for top, bottom in ((8, 246), (276, 397)):
        box = [SCALE * each for each in (left, top, right, bottom)]
        draw.rounded_rectangle(box, 14, fill=(9, 13, 19, 225), outline=(70, 82, 94, 255), width=2)
    payload, message = flight.payload[shot], flight.decoded[shot]
    write(draw, left + 10, 16, f"packet {shot}", 13, font="bold")
    write(draw, right - 10, 17, f"{len(payload)} bytes", 12, fill=DIM, anchor="ra")
    for index, (byte, colour) in enumerate(zip(payload, byte_colours(len(payload)), strict=True)):
        row, column = divmod(index, 11)
        write(draw, left + 10 + 19.6 * column, 36 + 13.7 * row, f"{byte:02x}", 11.5, font="mono", fill=colour)
    draw_cable(draw, (left + right) / 2, 246, 276, shot)
    write(draw, left + 10, 283, "flight computer", 13, font="bold")
    for beam, block in enumerate(message.beams):
        y = 302 + 23 * beam
        dot = [SCALE * each for each in (left + 10, y + 5, left + 20, y + 15)]
        draw.ellipse(dot, fill=LIGHTS[beam])
        if not block["range_valid"]:
            write(draw, left + 30, y + 1, "no return", 16, font="mono", fill=DIM)
            continue
        write(draw, left + 118, y, f"{block['range_m']:.1f} m", 16.5, font="mono", anchor="ra")
        write(draw, right - 10, y, f"{block['closing_speed_mps']:.2f} m/s", 16.5, font="mono", anchor="ra")


def byte_colours(length: int) -> list[Any]:
    """Colours of the bytes of a packet: header, one block per beam, checksum and delimiter."""
    packet = default_interface().packet
    # Before: a delimiter, the first byte of the byte stuffing, and 6 bytes of the packet's primary header.
    colours: list[Any] = [DIM] * (8 + packet.header.length)
    for light in LIGHTS:
        colours += [light] * packet.beam.length
    return colours + [DIM] * (length - len(colours))


def draw_cable(draw: ImageDraw.ImageDraw, x: float, top: float, bottom: float, shot: int) -> None:
    """A cable with plugs, and packets on their way."""
    draw.line([SCALE * x, SCALE * top, SCALE * x, SCALE * bottom], fill="#55626f", width=12)
    for y in (top, bottom):
        box = [SCALE * each for each in (x - 13, y - 4, x + 13, y + 4)]
        draw.rounded_rectangle(box, 6, fill="#8b98a5")
    for index in range(3):
        y = top + 4 + (index * 10 + shot * 0.45) % (bottom - top - 8)
        draw.ellipse([SCALE * (x - 3), SCALE * (y - 3), SCALE * (x + 3), SCALE * (y + 3)], fill=GOLD)
    write(draw, x + 20, (top + bottom) / 2, "serial cable", 12, anchor="lm", **EDGE)


def draw_readouts(picture: Image.Image, flight: Flight, shot: int) -> None:
    """Title, altitude, time, and the angle of the beams with its switch."""
    draw = ImageDraw.Draw(picture, "RGBA")
    write(draw, 16, 10, "lidar-emu", 22, font="bold")
    write(draw, 16, 38, f"powered descent\n{SPEED_UP}× real time", 12, fill="#b4bfca", **EDGE)
    last = shot_before_switch(flight, shot, EVENT_SHOTS)
    angle_deg = flight.angle_deg[shot]
    values = (
        (16, "altitude", f"{flight.position_m[shot, 2]:.1f} m", INK),
        (176, "time", f"{flight.time_s[shot]:.1f} s", INK),
        (288, "beams", f"{angle_deg:g}°", INK if last is None else GOLD),
    )
    for x, name, value, colour in values:
        write(draw, x, 349, name, 12, fill="#c3ccd5", **EDGE)
        write(draw, x, 363, value, 26, font="bold", fill=colour, **EDGE)
    if last is not None:
        box = [SCALE * each for each in (318, 92, 470, 146)]
        draw.rounded_rectangle(box, 12, fill=(24, 20, 6, 215), outline=GOLD, width=3)
        how = {"fill": GOLD, "font": "bold", "anchor": "mm"}
        write(draw, 394, 107, f"switch at {flight.position_m[last + 1, 2]:.0f} m", 13.5, **how)
        write(draw, 394, 130, f"{flight.angle_deg[last]:g}° → {angle_deg:g}°", 19, **how)


def draw_frame(moon: Moon, flight: Flight, shot: int, camera: Camera) -> Image.Image:
    """The picture of one shot."""
    tone = np.clip(0.62 * moon.picture(camera), 0, 1) ** (1 / 1.5)
    colour = np.stack([tone, tone * 0.985, tone * 0.95], axis=-1)
    picture = Image.fromarray((255 * colour).astype(np.uint8))
    picture = picture.resize((SCALE * WIDTH, SCALE * HEIGHT), Image.Resampling.BICUBIC)
    picture = add_light(picture, flight, shot, camera)
    w, x, y, z = flight.site_from_body[shot]
    attitude = Rotation.from_quat([x, y, z, w]).as_matrix()
    draw_lander(picture, camera, flight.position_m[shot], attitude)
    draw_panel(picture, flight, shot)
    draw_readouts(picture, flight, shot)
    return picture.resize((WIDTH, HEIGHT), Image.Resampling.LANCZOS)


def main() -> None:
    """Write the moving picture, or one of its frames."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("recording", type=Path, help="MCAP file of a run over a serial line")
    parser.add_argument("picture", type=Path, help="file to write, such as descent.webp")
    parser.add_argument("--time", type=float, metavar="S", help="one frame, at a time of the flight")
    options = parser.parse_args()
    if not options.picture.parent.is_dir() or options.picture.suffix not in Image.registered_extensions():
        parser.error(f"{options.picture}: must be a picture such as descent.webp in an existing folder")
    try:
        scenario, flight = read_flight(str(options.recording))
    except lidar_emu.InputError as error:
        parser.error(str(error))
    times_s = np.arange(START_S, flight.time_s[-1], SPEED_UP / FRAMES_PER_S)
    if options.time is not None:
        times_s = np.array([options.time])
    shots = np.searchsorted(flight.time_s[:-1], times_s)
    moon, follow = Moon(scenario), cameras(flight)
    first, *others = [draw_frame(moon, flight, shot, follow[shot]) for shot in shots]
    durations_ms = [1000 // FRAMES_PER_S] * len(others) + [HOLD_MS]
    moving = (
        {"save_all": True, "append_images": others, "duration": durations_ms, "loop": 0} if others else {}
    )
    first.save(options.picture, quality=QUALITY, method=6, **moving)


if __name__ == "__main__":
    main()
