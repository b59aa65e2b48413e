"""What happens in a simulated run: settings and happenings, drawn from a seed before the run begins."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from random import Random
from typing import Any, NamedTuple, TypeVar

T = TypeVar("T")

MS = 1_000_000
S = 1_000 * MS
CLOCK_ERROR_S = 100
_RECORDED, _RECOMPUTED = 2, 8
"""One run in so many is recorded, and flown again, which takes as long as the run."""


class Happening(NamedTuple):
    """Something that happens to a run."""

    at_ns: int
    """Simulated time since the start of the simulation."""
    kind: str
    values: tuple[Any, ...] = ()


@dataclass(frozen=True)
class Plan:
    """Settings and happenings of a run."""

    seed: int
    scenario: str
    settings: dict[str, str]
    link: str
    """`serial`, whose other end cannot be sensed, or `pty`."""
    baud: int
    """Bits per second that the line takes; 0: bits take no time."""
    pace: str
    start: str | None
    control: bool
    tick_ns: int
    wake_ns: int
    preempted: float
    shot_ns: int
    """Time that the model takes for a shot."""
    truth_ns: int
    """From truth to truth of a simulator."""
    truth_latency_ns: int
    pipe_bytes: int
    """Room of the pipe in which the port process reports: a page where a user has many pipes."""
    happenings: tuple[Happening, ...]

    @property
    def busy_wait_share(self) -> float:
        """Share of the time that the model process may spend in busy waits, as on one core and on several."""
        return 0.4 if self.seed % 4 < 2 else 0.0

    @property
    def is_recorded(self) -> bool:
        """Whether the run is recorded."""
        return self.seed % _RECORDED == 0 or any(each.kind == "fill disk" for each in self.happenings)

    @property
    def is_recomputed(self) -> bool:
        """Whether a recording is flown again."""
        return self.seed % _RECOMPUTED == 0

    @property
    def flight(self) -> tuple[tuple[str, str], ...]:
        """The settings on which the flight's model depends."""
        return tuple((key, self.settings[key]) for key in ("level", "timing.rate_hz", "duration_s"))

    def __str__(self) -> str:
        lines = (f"{h.at_ns / 1e9:.6f} s {h.kind} {' '.join(map(str, h.values))}" for h in self.happenings)
        listed = "".join(f"\n  {line[:200]}" for line in lines)
        settings = " ".join(f"{key}={value}" for key, value in self.settings.items())
        return (
            f"seed {self.seed}: {self.scenario} {settings}, {self.link} at {self.baud} bit/s, pace {self.pace}, "
            f"start {self.start}{listed}"
        )


_COMMANDS: tuple[tuple[str, dict[str, tuple[Any, ...]]], ...] = (
    ("no_op", {}),
    ("set_mode", {"mode": ("standby", "self_test", "acquire", "track", "safe")}),
    ("set_mode", {"mode": ("acquire", "track")}),
    ("set_pattern", {"pattern": (0, 1, 2, 255)}),
    ("set_rate_hz", {"rate_hz": (100.0, 50.0, 25.0, 33.0)}),
    ("enable_beams", {"beams": (15, 5, 0, 16)}),
    ("time_at_tone", {"tone_ns": (0, 10**9, 10**15)}),
    ("set_parameter", {"parameter": (0, 1, 2, 9), "number": (0.0, 0.3, 5.0, 10.0)}),
    ("reset", {"restart": ("warm", "cold")}),
)
_FAULTS = (
    "{kind: dropout, beams: [0], from_s: 0, to_s: 0.3}",
    "{kind: lost, from_s: 0, to_s: 0.1}",
    "{kind: reordered, from_s: 0.05, to_s: 0.2}",
    "{kind: delayed, from_s: 0, to_s: 0.2, delay_s: 0.03}",
    "{kind: stuck, beams: [1], from_s: 0.1, to_s: 0.5}",
    "{kind: disconnect, from_s: 0.05, to_s: 0.4}",
    "{kind: slow_line, from_s: 0, to_s: 0.5, bit_rate: 9600}",
    "{kind: interlock, from_s: 0.1, to_s: 0.15}",
    "{kind: brown_out, from_s: 0.1, to_s: 0.3}",
    f"{{kind: clock_error, offset_s: {CLOCK_ERROR_S}, from_s: 0.1, to_s: 0.9}}",
    "{kind: nonsense}",
)


def _duration_ns(random: Random) -> int:
    """From a tenth of a millisecond to three seconds, each decade alike."""
    return int(10 ** random.uniform(5, 9.5))


class _Habits:
    """What happens in a run: a few kinds of commands, faults and other happenings, for two that meet rarely among all
    kinds meet often among few (Groce et al., Swarm Testing, 2012)."""

    def __init__(self, random: Random, kinds: list[str]) -> None:
        self._random, self._last_ns = random, 0
        self._commands, self._faults, self._kinds = map(self._some, (_COMMANDS, _FAULTS, kinds))

    def _some(self, of: Sequence[T]) -> list[T]:
        return self._random.sample(of, self._random.randint(1, len(of)))

    def _when(self, end_ns: int) -> int:
        """At any time or soon after the happening that was drawn before, where it may still go on."""
        soon_ns = self._last_ns + _duration_ns(self._random)
        is_soon = self._random.random() < 0.5 and soon_ns < end_ns
        self._last_ns = soon_ns if is_soon else self._random.randrange(end_ns)
        return self._last_ns

    def command(self) -> tuple[str, dict[str, Any]]:
        name, arguments = self._random.choice(self._commands)
        return name, {key: self._random.choice(values) for key, values in arguments.items()}

    def happening(self, end_ns: int) -> Happening:
        return self.of_kind(self._random.choice(self._kinds), end_ns)

    def of_kind(self, kind: str, end_ns: int) -> Happening:
        random, at_ns = self._random, self._when(end_ns)
        match kind:
            case "command":
                how = random.choice(("whole", "whole", "whole", "split", "twice", "torn", "skipped"))
                return Happening(at_ns, kind, (*self.command(), how))
            case "commands":
                return Happening(at_ns, kind, tuple(self.command() for _ in range(random.randrange(2, 20))))
            case "noise":
                return Happening(at_ns, kind, (random.randbytes(random.randrange(1, 300)),))
            case "inject":
                return Happening(at_ns, kind, (random.choice(self._faults),))
            case "control":
                return Happening(at_ns, kind, self.command())
            case "step utc":
                # Not before a start at an instant, which would be a day away.
                return Happening(max(at_ns, S), kind, (random.uniform(-1e5, 1e5),))
            case "kill port" | "kill model" | "interrupt":
                return Happening(at_ns, kind)
            case "repeat truth" | "another simulator":
                return Happening(at_ns, kind)
            case "damage truth":
                return Happening(at_ns, kind, (random.randbytes(random.choice((0, 3, 152))),))
            case "fill disk":
                return Happening(at_ns, kind, (random.randrange(100_000),))
        return Happening(at_ns, kind, (_duration_ns(random),))


def draw(seed: int) -> Plan:
    """The plan of a seed."""
    random = Random(seed)
    live = random.random() < 0.2
    pace = random.choice(("wall", "wall", "lockstep") if live else ("wall", "wall", "wall", "max"))
    link = random.choice(("serial", "serial", "pty", "can"))
    rate_hz = random.choice((100, 300, 300 if link == "can" else 500))
    duration_s = random.choice((1.0, 2.0, 4.0))
    settings = {
        "level": "geometric",
        "timing.rate_hz": str(rate_hz),
        "duration_s": str(duration_s),
    }
    start = None if live else random.choice((None, None, "on-command" if pace == "wall" else None, "instant"))
    if random.random() < 0.5 or start == "on-command":
        settings["device.start"] = random.choice(("standby", "boot", "track"))
        settings["device.boot_s"] = str(random.choice((0.0, 0.1, 0.5)))
        settings["device.self_test_s"] = str(random.choice((0.0, 0.2)))
        settings["device.acquisition_s"] = str(random.choice((0.0, 0.25)))
        settings["device.after_boot"] = random.choice(("standby", "track"))
    if random.random() < 0.15:
        settings["timing.when_late"] = "abort"
    if random.random() < 0.3:
        settings["timing.when_process_dies"] = "safe"
    control = random.random() < 0.4
    kinds = ["command"] * 3 + [
        "commands",
        "noise",
        "flood",
        "stall model",
        "stall port",
        "stall line",
        "step utc",
    ]
    if live:
        kinds += ["lose truth", "hold truth", "repeat truth", "damage truth", "another simulator"]
        settings["trajectory.stale_after_s"] = str(random.choice((0.05, 0.5)))
        settings["trajectory.when_stale"] = random.choice(("coast", "coast", "invalid", "abort"))
    kinds.append("hang up" if link == "pty" else "unplug")
    if control:
        kinds += ["control", "control"] if pace != "wall" else ["inject", "inject", "control"]
    end_ns = int((duration_s + 0.7) * S)
    habits = _Habits(random, kinds)
    drawn = [habits.happening(end_ns) for _ in range(random.randrange(random.choice((3, 12, 40))))]
    polled = Random(f"polled {seed}")
    if pace == "wall" and polled.random() < 0.1:
        settings["wire.polled"] = "true"
        drawn += [
            Happening(polled.randrange(end_ns), "command", ("no_op", {}, "whole"))
            for _ in range(polled.choice((5, 100)))
        ]
    if start == "on-command":
        drawn.append(Happening(random.randrange(S), "command", ("set_mode", {"mode": "acquire"}, "whole")))
    if random.random() < 0.35:
        last = random.choice(("kill port", "kill model", "interrupt", "interrupt", "fill disk", "fill disk"))
        drawn.append(habits.of_kind(last, end_ns))
    bauds = {"serial": random.choice((0, 460_800, 921_600)), "pty": 0, "can": random.choice((0, 1_000_000))}
    baud = bauds[link]
    if pace == "max" and link != "can" and seed % 2:
        # Longer than the sender waits for a line that takes nothing, and than it waits for one that empties.
        baud = 9_600 if link == "serial" or random.random() < 0.5 else 1_200
        settings |= {"timing.rate_hz": "100", "duration_s": "1.0"} if baud == 1_200 else {}
    return Plan(
        seed,
        "live.yaml" if live else "descent.yaml",
        settings,
        link,
        baud,
        pace,
        start,
        control,
        random.choice((100, 2_000, 20_000)),
        random.choice((10_000, 100_000, 1_000_000)),
        random.choice((0.0, 0.005, 0.02)),
        random.choice((5_000, 50_000, 500_000, round(1.1e9 / rate_hz))),
        random.choice((5 * MS, 10 * MS, 35 * MS)),
        random.choice((100_000, 5 * MS, 30 * MS)),
        random.choice((4_096, 65_536)),
        tuple(sorted(drawn, key=lambda each: each.at_ns)),
    )
