"""Options that several commands share."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import wraps
from itertools import zip_longest
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Any

import click
from click.shell_completion import CompletionItem

from lidar_emu.errors import Finding, InputError
from lidar_emu.transports.spec import (
    DEFAULT_BAUD,
    DEFAULT_BITRATE,
    DEFAULT_DATA_BITRATE,
    Kind,
    PortSpec,
    parse_port,
)

if TYPE_CHECKING:
    from lidar_emu.runtime.summary import Tally
    from lidar_emu.scenario.schema import BenchScenario, FlightScenario

Command = Callable[..., Any]

_SECTIONS = {
    "Scenario": "duration seed settings exact",
    "Link": "port baud serial_format rs485 interface channel bitrate fd data_bitrate"
    " wire_interface control unit sequence",
    "Timing": "pace speed start wait_limit from_s until_s loop timeout count",
    "Output": "record viewer to recompute summary_file fail_on plain as_json",
}
_OTHERS = "Other options"
_OPTION_COLUMNS = 26


class SectionedCommand(click.Command):
    """A command whose help lists its options by subject."""

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        rows: dict[str, list[tuple[str, str]]] = {heading: [] for heading in (*_SECTIONS, _OTHERS)}
        for parameter in self.get_params(ctx):
            subjects = (heading for heading, names in _SECTIONS.items() if parameter.name in names.split())
            if (row := parameter.get_help_record(ctx)) is not None and row[1]:
                rows[next(subjects, _OTHERS)].append((row[0].ljust(_OPTION_COLUMNS), row[1]))
        for heading, listed in rows.items():
            if listed:
                with formatter.section(heading):
                    formatter.write_dl(listed, _OPTION_COLUMNS)


scenario_argument = click.argument("scenario")
settings_option = click.option(
    "--set",
    "settings",
    metavar="KEY=VALUE",
    multiple=True,
    help="Replace a key of the scenario, e.g. timing.rate_hz=100 (repeatable).",
)
geometry_option = click.option(
    "--geometry", metavar="FILE.npz", help="Use trajectory and ground from a recorded geometry."
)
wire_interface_option = click.option(
    "--wire-interface", metavar="FILE", default="default", help="Message definitions: a name, or FILE.toml."
)
_FAILURES = ("late", "dropped")
fail_on_option = click.option(
    "--fail-on",
    metavar="WHAT",
    help="Exit 1 if packets were late or dropped (late,dropped: either), or if Ctrl-C interrupted the run.",
)
wait_limit_option = click.option(
    "--wait-limit",
    metavar="S",
    help="Give up waiting for the start.  [default: 60 for a host, no limit for truth and commands]",
)
json_lines_option = click.option(
    "--json",
    "as_json",
    is_flag=True,
    help='Print two lines of JSON instead: {"ready": ...} once the port is open, and the summary.',
)
plain_option = click.option("--plain", is_flag=True, help="Print lines instead of a live display.")
_SCENARIO_OPTIONS = (
    scenario_argument,
    click.option("--duration", metavar="S", help="Fly only the first seconds."),
    click.option("--seed", metavar="N", help="Seed, instead of the scenario's."),
    settings_option,
    click.option("--exact", is_flag=True, help="Compute everything, whatever its effect."),
)


def scenario_options(command: Command) -> Command:
    """Add to a click command the parameters `scenario`, `duration`, `seed`, `settings` and `exact`."""
    for option in reversed(_SCENARIO_OPTIONS):
        command = option(command)
    return command


class _TextOrFile(click.types.StringParamType):
    """Text that a shell completes as the name of a file, as it does for programs that it does not know."""

    def shell_complete(self, _: click.Context, __: click.Parameter, incomplete: str) -> list[CompletionItem]:
        return [CompletionItem(incomplete, type="file")]


def set_up_values(command: click.Command) -> None:
    """For a command and those below it, complete texts as files, and refuse an empty value of any option: a script's
    empty variable, mostly."""
    if isinstance(command, click.Group):
        for below in command.commands.values():
            set_up_values(below)
    for parameter in command.params:
        if parameter.type is click.STRING:
            parameter.type = _TextOrFile()
        if isinstance(parameter, click.Option) and parameter.callback is None:
            parameter.callback = _not_empty


def _not_empty(_context: click.Context, option: click.Parameter, value: Any) -> Any:
    if value == "" or (isinstance(value, tuple) and "" in value):
        raise InputError(option.opts[-1], None, "", f"must be a value, or no {option.opts[-1]}")
    return value


def setting_of(error: click.NoSuchOption, words: list[str]) -> str | None:
    """The `--set` that an unknown option of a command line meant, `timing.rate_hz=10` for `--rate-hz 10`; None if it is
    named after no key, or the command sets none."""
    options = {each.name for each in error.ctx.command.params if each.name} if error.ctx else set()
    if "settings" not in options:
        return None
    from lidar_emu.scenario.hints import key_of_option
    from lidar_emu.scenario.schema import FlightScenario

    name = error.option_name.lstrip("-").replace("-", "_")
    key = key_of_option(FlightScenario.model_json_schema(), name, options)
    if key is None:
        return None
    parts = [part for word in words for part in (word.split("=", 1) if word[:2] == "--" else [word])]
    value = next(iter(parts[parts.index(error.option_name) + 1 :]), "")
    return f"{key}={quote(value) if value and value[:2] != '--' else 'VALUE'}"


def plot_option(what: str, name: str = "--plot") -> Command:
    """The option that names the files of a plot, by what it shows."""
    help_text = f"Plot {what} (repeatable). Light on dark: FILE-dark.png."
    return click.option(name, metavar="FILE.png|svg|pdf", multiple=True, help=help_text)


def check_plot(plot: tuple[str, ...]) -> None:
    """Check the paths of a plot before a long computation.

    Raises:
        InputError: the path cannot be used, or the extra that draws is not installed.
    """
    for path in plot:
        from lidar_emu.report.plot_style import check_plot_path

        check_plot_path(Path(path))


def require_port(port: PortSpec, command: str) -> None:
    """Reject the loopback for a command that needs another program at the other end.

    Raises:
        InputError: no port was given.
    """
    if port.kind is Kind.LOOPBACK:
        remedy = "pass --port PORT, or --interface and --channel"
        raise InputError(command, None, Finding("no port"), remedy)


def load_scenario(
    scenario: str, duration: str | None, seed: str | None, settings: tuple[str, ...], exact: bool = False
) -> FlightScenario | BenchScenario:
    """Load a scenario with the changes given by options.

    Raises:
        InputError: a setting without a key or a value, an interface that cannot be used, or an error of `load`, under
            the option's own name.
    """
    from lidar_emu.scenario.load import load_with_settings
    from lidar_emu.wire import interface_named

    options = {
        "duration_s": ("--duration", duration),
        "seed": ("--seed", seed),
        "left_out_share": ("--exact", "0" if exact else None),
    }
    given = {key: (option, text) for key, (option, text) in options.items() if text is not None}
    try:
        flown = load_with_settings(
            scenario, keys_and_values(settings) | {key: text for key, (_, text) in given.items()}
        )
    except InputError as error:
        for key, (option, _) in given.items():
            if (error.where, error.key) == ("--set", key) or error.where == f"--set {key}":
                raise InputError(option, None, error.value, error.remedy) from None
        raise
    where = "--set" if any(key.partition(".")[0] == "wire" for key in keys_and_values(settings)) else scenario
    interface_named(flown.wire.interface, where, "wire.interface")
    return flown


def as_number(option: str, text: str) -> float:
    """The value of an option as a positive number.

    Raises:
        InputError: not a number above 0.
    """
    number = number_in(text)
    if not 0.0 < number < math.inf:
        raise InputError(option, None, text, "must be a number above 0")
    return number


def as_instant(option: str, text: str) -> float:
    """The value of an option as an instant in seconds.

    Raises:
        InputError: not a number of seconds.
    """
    instant_s = number_in(text)
    if not abs(instant_s) < 1e9:
        raise InputError(option, None, text, "must be a number of seconds")
    return instant_s


def number_in(text: str) -> float:
    """The number that a text states; NaN if it states none."""
    try:
        return float(text)
    except ValueError:
        return math.nan


def as_whole(option: str, text: str, least: int = 1, most: int = 999_999_999) -> int:
    """The value of an option as a whole number from `least` to `most`.

    Raises:
        InputError: not such a number.
    """
    if not (text.isascii() and text.isdecimal() and 0 < len(text) < 10 and least <= int(text) <= most):
        words = "above 0" if least == 1 else f"from {least} to {most}"
        raise InputError(option, None, text, f"must be a whole number {words}")
    return int(text)


def keys_and_values(settings: tuple[str, ...]) -> dict[str, str]:
    """The keys and values of `settings_option`.

    Raises:
        InputError: a setting without a key or a value.
    """
    result = {}
    for setting in settings:
        key, separator, value = setting.partition("=")
        if not (key and separator and value):
            raise InputError("--set", None, setting, "must be KEY=VALUE, e.g. timing.rate_hz=100")
        result[key] = value
    return result


def failures_named(text: str | None, in_real_time: bool) -> set[str]:
    """The failures listed by `--fail-on`; none without it.

    Raises:
        InputError: an unknown word, no word at all, or `late` where the wall clock does not set the pace.
    """
    names = {name.strip() for name in (text or "").split(",") if name.strip()}
    for name in sorted(names - set(_FAILURES)):
        raise InputError("--fail-on", None, name, f"must be {', '.join(_FAILURES)}")
    if text is not None and not names:
        raise InputError("--fail-on", None, text, f"must be {', '.join(_FAILURES)}")
    if "late" in names and not in_real_time:
        remedy = "can only be dropped: nothing is late unless the wall clock sets the pace"
        raise InputError("--fail-on", None, text, remedy)
    return names


def has_failed(tally: Tally, interrupted: bool, failures: set[str]) -> bool:
    """Whether a failure listed by `--fail-on` occurred; an interrupted run counts as a failure."""
    lost = {"late": tally.late > 0, "dropped": tally.dropped > 0}
    return bool(failures) and (interrupted or any(lost[name] for name in failures))


_PORT_OPTIONS = (
    click.option(
        "--port",
        metavar="PORT",
        multiple=True,
        help="Serial device, pyserial URL, pty, pty:LINK, udp:[HOST:]PORT, tcp:[HOST:]PORT, or unix:PATH.",
    ),
    click.option(
        "--baud", type=int, metavar="N", help=f"Serial bit rate in bit/s.  [default: {DEFAULT_BAUD}]"
    ),
    click.option(
        "--serial-format",
        metavar="8E1",
        help="Data bits, parity (N, E, O) and stop bits of a serial line.  [default: the interface's, 8N1]",
    ),
    click.option(
        "--rs485", is_flag=True, help="Let the serial driver enable the RS-485 transmitter while it sends."
    ),
    click.option("-i", "--interface", metavar="NAME", help="python-can interface name, e.g. socketcan."),
    click.option("-c", "--channel", metavar="NAME", multiple=True, help="CAN channel, e.g. vcan0."),
    click.option(
        "--bitrate", type=int, metavar="N", help=f"CAN bit rate in bit/s.  [default: {DEFAULT_BITRATE}]"
    ),
    click.option("--fd", is_flag=True, help="CAN FD frames."),
    click.option(
        "--data-bitrate",
        type=int,
        metavar="N",
        help=f"CAN FD bit rate of the data phase in bit/s.  [default: {DEFAULT_DATA_BITRATE}]",
    ),
)


def port_options(command: Command) -> Command:
    """Give a click command the port options; it receives one `PortSpec` as the keyword argument `port`.

    Raises (when the command is called):
        InputError: see `parse_port`.
    """

    @wraps(command)
    def with_port(*args: Any, ports: list[PortSpec], **others: Any) -> Any:
        port, *more = ports
        for other in more:
            option = "--channel" if other.kind is Kind.CAN else "--port"
            raise InputError(option, None, str(other), "can be given once")
        return command(*args, port=port, **others)

    return ports_options(with_port)


def ports_options(command: Command) -> Command:
    """Give a click command the port options, for several ports; it receives a list as the keyword argument `ports`, the
    loopback alone if none is given.

    Raises (when the command is called):
        InputError: see `parse_port`.
    """

    @wraps(command)
    def with_ports(
        *args: Any,
        port: tuple[str, ...],
        baud: int | None,
        serial_format: str | None,
        rs485: bool,
        interface: str | None,
        channel: tuple[str, ...],
        bitrate: int | None,
        fd: bool,
        data_bitrate: int | None,
        **others: Any,
    ) -> Any:
        ends = zip_longest(port, channel) if port or channel else [(None, None)]
        ports = [
            parse_port(path, baud, interface, bus, bitrate, fd, data_bitrate, rs485, serial_format)
            for path, bus in ends
        ]
        return command(*args, ports=ports, **others)

    for option in reversed(_PORT_OPTIONS):
        with_ports = option(with_ports)
    return with_ports
