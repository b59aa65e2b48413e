"""Every command of lidar-emu that a page names exists and has the options shown, also where it cannot be run here."""

from __future__ import annotations

import contextlib
import re
import shlex
from collections.abc import Iterator
from pathlib import Path

import click
import pytest
from printed_blocks import PAGES, ROOT, blocks

from lidar_emu.cli import cli

DECISIONS = sorted((ROOT / "docs" / "decisions").glob("*.md"))
SHELL_OPERATORS = {"&", "&&", "|", ">"}


def parse(typed: str) -> None:
    """Parse a command as the program does, without running it.

    Raises click.UsageError where the program would refuse a name or an option.
    """
    words = shlex.split(typed, comments=True)[1:]
    end = next((k for k, word in enumerate(words) if word in SHELL_OPERATORS), len(words))
    command, words = cli, words[:end]
    while isinstance(command, click.Group) and words:
        _, command, words = command.resolve_command(click.Context(command), words)
    assert command is not None
    # A command keeps its first help option, whose names it has from the program.
    command.make_context("lidar-emu", words, click.Context(cli, **cli.context_settings))


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_commands_in_blocks(page: Path) -> None:
    for block in blocks(page):
        for typed in block.commands if block.language == "sh" else []:
            if typed.startswith("lidar-emu "):
                parse(typed)


@pytest.mark.parametrize("page", PAGES + DECISIONS, ids=lambda page: str(page.relative_to(ROOT)))
def test_commands_in_sentences(page: Path) -> None:
    """A sentence may leave out the scenario and other arguments."""
    for typed in re.findall(r"`(lidar-emu [a-z][^`\n]*)`", page.read_text(encoding="utf-8")):
        with contextlib.suppress(click.MissingParameter):
            parse(typed)


def commands(command: click.Command) -> Iterator[click.Command]:
    yield command
    for below in command.commands.values() if isinstance(command, click.Group) else ():
        yield from commands(below)


def test_examples_in_help() -> None:
    examples = [line.strip() for command in commands(cli) for line in (command.help or "").splitlines()]
    examples = [line for line in examples if line.startswith("lidar-emu ")]
    assert len(examples) > 80
    for typed in examples:
        parse(re.sub(r"\s{2,}.*", "", typed))


@pytest.mark.parametrize(
    "typed", ["lidar-emu fly descent.yaml", "lidar-emu run descent.yaml --prot pty", "lidar-emu run"]
)
def test_what_the_program_refuses_is_noticed(typed: str) -> None:
    with pytest.raises(click.UsageError):
        parse(typed)
