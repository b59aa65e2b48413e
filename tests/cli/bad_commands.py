"""Command lines that cannot be used, with good files."""

from __future__ import annotations

from bad_case import BENCH, FLIGHT, SIMULATE, Case

_LONG = 300 * "x"
_ENDLESS = ".".join(1000 * "a")
_NINE_BEAMS = BENCH + 8 * "    - {range_m: 1, closing_speed_mps: 1}\n"

_OPTIONS: list[tuple[str, str, tuple[str, ...]]] = [
    ("unknown command", "fly my.yaml", ("'fly'", "lidar-emu --help")),
    ("no scenario", "run", ("SCENARIO", "lidar-emu run --help")),
    ("no such scenario", "plan missing.yaml", ("missing.yaml: no such file", "descent.yaml")),
    ("a folder", "plan .", (".: a folder", "allowed: a path to a YAML file")),
    ("a name too long", f"plan {_LONG}", ("xxx: no such file", "descent.yaml")),
    ("unknown option", "run my.yaml --bogus", ("--bogus", "lidar-emu run --help")),
    ("pace", "run my.yaml --pace slow", ("--pace", "'slow'", "'wall', 'max'")),
    ("start in the past", "run my.yaml --record out.mcap --start 2001-01-01T00:00:00Z",
     ("--start: '2001-01-01T00:00:00Z'", "past", "allowed: now")),
    ("start garbage", "run my.yaml --start soon", ("--start: 'soon'", "allowed: now")),
    ("start by nobody's command", "run my.yaml --start on-command", ("--start: on-command", "nobody", "--port")),
    ("control without a name", "run my.yaml --control=", ("--control: ''", "allowed: a path")),
    ("an argument twice", "send --port /dev/nowhere set_mode mode=track mode=safe",
     ("'mode=safe'", "has mode already")),
    ("half a beam", "send --port /dev/nowhere enable_beams beams=2.5", ("beams=2.5", "a whole number")),
    ("fail-on garbage", "run my.yaml --fail-on late,early", ("--fail-on: 'early'", "late, dropped")),
    ("set without =", "run my.yaml --set seed", ("--set: 'seed'", "KEY=VALUE")),
    ("set without value", "run my.yaml --set seed=", ("--set: 'seed='", "KEY=VALUE")),
    ("set of unknown key", "run my.yaml --set timing.rate=5", ("--set: timing.rate: 5", "rate_hz")),
    ("set of unknown mapping", "run my.yaml --set colours.sky=red", ("--set: colours", "no such key", "timing")),
    ("set below a word", "run my.yaml --set name.first=1", ("--set: name.first: 'first'", "allowed")),
    ("set beyond a list", "run my.yaml --set bench_pattern.beams.7.valid=off", ("beams.7.valid: '7'", "0 to 0")),
    ("set of odd digits", "run my.yaml --set bench_pattern.beams.²=1", ("beams.²: '²'", "from 0 to 0")),
    ("set of broken YAML", "run my.yaml --set name=[", ("--set name: line 1", "YAML 1.2")),
    ("set of an endless key", f"run my.yaml --set {_ENDLESS}=1", ("--set: a.a.a", "1000 steps", "32")),
    ("set of a site for a pattern", "run my.yaml --set site=flat", ("--set: site: 'flat'", "bench_pattern")),
    ("set of an address without host", "run live.yaml --set trajectory.listen=udp::5600",
     ("--set: trajectory.listen: 'udp::5600'", "allowed: udp:HOST:PORT, e.g. udp:127.0.0.1:5600", "unix:PATH")),
    ("duration below zero", "run my.yaml --duration -1", ("--duration: -1 ", "greater than 0")),
    ("duration nan", "run my.yaml --duration nan", ("--duration: 'nan'", "a number")),
    ("broken duration", "run my.yaml --duration [", ("--duration: ", "YAML 1.2")),
    ("negative seed", "run my.yaml --seed -1", ("--seed: -1 ", "greater than or equal to 0")),
    ("seed too large", "run my.yaml --seed 9223372036854775808", ("--seed: 9223372036854775808", "18 digits")),
    ("simulate without output", "simulate my.yaml", ("simulate: no output", "--out FILE, --plot FILE.png")),
    ("out of unknown kind", "simulate my.yaml --out out.xlsx", ("out.xlsx", ".csv, .npz")),
    ("plot of unknown kind", "simulate my.yaml --plot out.jpg", ("out.jpg", ".png")),
    ("out into no folder", "simulate my.yaml --out nowhere/out.csv", ("nowhere/out.csv", "no such folder")),
    ("points of a pattern", "simulate my.yaml --out out.ply", ("out.ply", "bench pattern", "allowed: a flight")),
    ("plot of a pattern", f"{SIMULATE} --plot out.png", ("bench pattern", "allowed: a flight")),
    ("record into no folder", "run my.yaml --record nowhere/out.mcap", ("--record: 'nowhere/", "a folder that")),
    ("record under a name too long", f"run my.yaml --record {_LONG}", ("--record: 'xxx", "the name of a file")),
    ("summary onto a folder", "run my.yaml --summary .", ("--summary: '.'", "allowed: the name of a file")),
    ("documents into no folder", "icd --out nowhere", ("--out: 'nowhere'", "a folder that exists")),
    ("documents of no interface", "icd --interface sonar", ("--interface: 'sonar'", "default, altimeter", "FILE.toml")),
    ("documents of a missing file", "icd --interface sonar.toml", ("sonar.toml: no such file", "a TOML file")),
    ("documents of a scenario", "icd --interface my.toml.yaml", ("--interface: 'my.toml.yaml'", "FILE.toml")),
    ("unknown interface to listen", "listen --port pty --wire-interface x", ("--wire-interface: 'x'", "altimeter")),
    ("unknown interface to run", "run my.yaml --set wire.interface=sonar", ("wire.interface: 'sonar'", "altimeter")),
    ("no beams for the interface", "run my.yaml --set wire.interface=altimeter", ("beams: 1", "at least 3")),
]  # fmt: skip

_PORTS: list[tuple[str, str, tuple[str, ...]]] = [
    ("no such port", "run my.yaml --port /dev/nowhere --record out.mcap --summary out.json",
     ("--port: '/dev/nowhere'", "no such port")),
    ("no port at all", "run my.yaml --port my.yaml", ("--port: 'my.yaml'", "not a serial device")),
    ("no UDP port", "run my.yaml --port udp:bench", ("--port: 'udp:bench'", "udp:HOST:PORT")),
    ("RS-485 on a pty", "run my.yaml --port pty --rs485", ("--rs485", "only with a serial device")),
    ("unknown URL", "run my.yaml --port carrier://pigeon", ("--port: 'carrier://pigeon'", "pyserial's URLs")),
    ("two ports", "run my.yaml --port /dev/ttyS0 -i socketcan -c vcan0", ("--port: '/dev/ttyS0'", "allowed: one port")),
    ("baud without port", "run my.yaml --baud 9600", ("--baud: 9600", "together with --port")),
    ("negative baud", "run my.yaml --port pty --baud -9600", ("--baud: -9600", "a positive number")),
    ("baud in words", "run my.yaml --port pty --baud fast", ("--baud", "'fast'", "integer")),
    ("wire too slow", "run my.yaml --port pty --baud 1200 --set timing.rate_hz=100", ("--baud: 1200", "too slow")),
    ("unknown CAN interface", "run my.yaml -i pigeon -c x", ("--interface: 'pigeon'", "socketcan")),
    ("no CAN channel", "run my.yaml -i socketcan", ("--channel", "allowed: the channel")),
    ("channel without interface", "run my.yaml -c vcan0", ("--channel: 'vcan0'", "together with --interface")),
    ("virtual bus", "run my.yaml -i virtual -c x", ("--interface: 'virtual'", "allowed: socketcan")),
    ("listen without port", "listen", ("listen: no port", "allowed: --port PORT")),
    ("listen to no port", "listen --port /dev/nowhere", ("--port: '/dev/nowhere'", "no such port")),
    ("listen for nothing", "listen --port pty --count 0", ("--count", "0 is not in the range")),
]  # fmt: skip

CASES = [
    *(Case(name, says, {"my.yaml": BENCH}, command) for name, command, says in (*_OPTIONS, *_PORTS)),
    Case("set of unknown part", ("--set: site: 'venus'", "mare"), {"my.yaml": FLIGHT}, f"{SIMULATE} --set site=venus"),
    Case("nine beams on CAN", ("beams: 9", "at most 8"), {"my.yaml": _NINE_BEAMS}, "run my.yaml -i socketcan -c vcan0"),
]  # fmt: skip
