"""Blocks that a page prints: commands, Python, and files; what each needs before it can run here."""

from __future__ import annotations

import re
import shutil
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PAGES = [
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    *sorted((ROOT / "docs").glob("*.md")),
    *sorted((ROOT / "docs" / "evidence").glob("*.md")),
    *sorted((ROOT / "examples").glob("*/README.md")),
    ROOT / "protocol" / "lidar_protocol" / "INTERFACE.md",
    ROOT / "protocol" / "lidar_protocol" / "README.md",
]
PROGRAMS = [
    "lidar-emu",
    "python",
    "pytest",
    "cc",
    "head",
    "cp",
    "mkdir",
    "git",
    "cd",
    "make",
    "pip",
    "sudo",
    "candump",
    "socat",
    "tshark",
    "chromium",
]
BLOCK = re.compile(
    r"(?:<!-- (?P<mark>[a-z ]+): (?P<reason>.+?) -->\n\n?)?"
    r'(?:^```(?P<language>\w+)(?: title="(?P<title>[^"]+)")?[^\n]*\n(?P<fenced>.*?)^```$'
    r"|(?<=\n\n)(?P<indented>(?:^    [^\n]+\n)+))",
    re.MULTILINE | re.DOTALL,
)
# What a command itself shows that it needs.
NEEDS = {
    "hardware": re.compile(r"/dev/tty(USB|ACM|S)\d|\bcan0\b"),
    "root": re.compile(r"\bsudo\b"),
    "a capture of a bus": re.compile(r"\bcandump\.log\b"),
    "vcan0": re.compile(r"\bvcan0\b"),
    "more than 30 s": re.compile(
        r"^lidar-emu (campaign (?!.*--(plan|runs))|bench accuracy)|compare\.py| # \d+ min$"
    ),
    "an environment of its own": re.compile(r"^(git|cd|make|pip|\. )|^\.venv/|^pytest"),
    "a browser": re.compile(r"^chromium\b"),
}
# Run where they are installed.
OTHER_PROGRAMS = "candump", "socat", "tshark"
MARKS = "needs", "takes", "run by", "not run"


@dataclass(frozen=True)
class Block:
    """A block with its line in the page; `language` is sh for commands. `left_out` is None for a block that is run."""

    line: int
    language: str
    text: str
    left_out: str | None
    title: str | None = None

    @property
    def commands(self) -> list[str]:
        """Lines to type, continued ones joined. With prompts, the other lines are output."""
        lines = re.sub(r" \\\n *", " ", self.text).splitlines()
        typed = [line[2:] for line in lines if line.startswith("$ ")]
        return typed or [line for line in lines if line and not line.startswith("#")]

    @property
    def file(self) -> str | None:
        """Name of the file whose content the block is: its title, or in its first line, such as `# my.yaml`."""
        named = re.match(r"# ([\w.-]+\.(?:ya?ml|toml))\b", self.text)
        return self.title or (named and named[1])


def needs(command: str) -> str | None:
    """What keeps a command from being run here."""
    for need, shown in NEEDS.items():
        if shown.search(command):
            return need
    program = command.split(" ", 1)[0]
    return program if program in OTHER_PROGRAMS and not shutil.which(program) else None


def blocks(page: Path) -> list[Block]:
    """Blocks of commands and Python and files, in the order of the page.

    Raises ValueError for a mark, or a line among commands, that is not recognised.
    """
    text = page.read_text(encoding="utf-8")
    found = []
    for match in BLOCK.finditer(text):
        line = (
            text.count("\n", 0, match.start("fenced") if match["language"] else match.start("indented")) + 1
        )
        body = match["fenced"] or re.sub("^    ", "", match["indented"] or "", flags=re.MULTILINE)
        language = match["language"] or ("sh" if is_command(body.split("\n", 1)[0]) else "text")
        block = Block(
            line, "sh" if language in ("sh", "console") else language, body, left_out(match), match["title"]
        )
        if block.language == "sh" or block.language == "python" or block.file:
            found.append(block)
        if block.language == "sh" and not block.left_out:
            for command in block.commands:
                if not is_command(command):
                    raise ValueError(f"{page.name}:{line}: not recognised as a command: {command}")
    return found


def is_command(line: str) -> bool:
    word = line.removeprefix("$ ").split(" ")[0]
    return word in [*PROGRAMS, "."] or word.startswith(("./", ".venv/"))


def left_out(match: re.Match[str]) -> str | None:
    if match["mark"] is None:
        return None
    if match["mark"] not in MARKS:
        raise ValueError(f"mark not recognised: {match[0].splitlines()[0]}")
    if match["mark"] == "run by" and not (ROOT / match["reason"]).is_file():
        raise ValueError(f"no such file: {match['reason']}")
    return f"{match['mark']}: {match['reason']}"
