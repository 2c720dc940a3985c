"""Pages whose commands run: every block in order, in one folder, as a reader does it.

A block ```` ```python title="mine.py" ```` (of any language) is a file that the reader
writes. In a ```` ```console ```` block a line `$ command` is run and the lines below it
are what it prints: standard output, and the error where the exit code is 2. A line
`...` stands for lines that the page leaves out. `$ echo $?` is the exit code of the
command above; one that is not 0 must be followed by it.

What a page shows is what is printed, by this rule: words are equal to the letter; the
number of blanks is free, for columns widen with their numbers; whole numbers are equal;
any other number may differ by one unit in its last printed digit, for other versions
and processors round otherwise, and two numbers below 1e-12 are both rounding. How long
something took, as in `1 passed in 0.23s`, is not compared.

A picture whose title is a file, `![..](../pictures/run.webp "run/report.html")`, shows
the top of that file, which the commands of the page have written.

`PYTHONPATH=tests python tests/documents/walkthrough.py docs/tutorials/*.md` runs pages
and writes into them what is printed now, and their pictures, if there is a browser;
read the difference before it is committed.
"""

import base64
import contextlib
import difflib
import io
import os
import re
import shlex
import subprocess
import sys
import tempfile
from dataclasses import dataclass, field
from pathlib import Path

import places
from browser import browser, find_chromium

from simval.cli import run

FENCE = re.compile(r"```(\w+)(?: title=\"([^\"]+)\")?\n(.*?)```\n", re.S)
NUMBER = re.compile(r"(?<![\w.])[-−]?\d+(?:\.\d+)?(?:e[-+]?\d+)?(?!\w)")
PICTURE = re.compile(r'^!\[[^\]]+\]\(([^ ]+) "([^"]+\.html)"\)$', re.M)
TOOK = re.compile(r"(?<= in )\d+\.\d+s$")
ROUNDING = 1e-12
LEFT_OUT = "..."


@dataclass(frozen=True)
class Command:
    """One line after `$`, where it stands, and the lines that the page shows."""

    words: str
    line: int
    shown: tuple[str, ...]


@dataclass(frozen=True)
class Block:
    """A fenced block of a page: a file that is written, or commands."""

    section: str
    line: int
    language: str
    title: str
    text: str

    def commands(self):
        at, found = self.line + 1, []
        for number, text in enumerate(self.text.splitlines(), at):
            if found and found[-1][0].endswith("\\") and not found[-1][2]:
                found[-1][0] = found[-1][0][:-1] + text.strip().removeprefix("> ")
            elif text.startswith("$ "):
                found.append([text[2:], number, []])
            else:
                found[-1][2].append(text)
        return [Command(words, line, tuple(shown)) for words, line, shown in found]


def blocks(text):
    """The blocks of a page that are run, in order."""
    found = []
    for match in FENCE.finditer(text):
        language, title, body = match.groups()
        if language != "console" and title is None:
            continue
        before = text[: match.start()]
        heads = re.findall(r"^##+ (.+)$", FENCE.sub("", before), re.M)
        section = heads[-1] if heads else ""
        line = before.count("\n") + 1
        found.append(Block(section, line, language, title or "", body))
    return found


@dataclass
class Walk:
    """A page in its folder, run as far as some section."""

    page: Path
    folder: Path
    done: int = 0
    code: int = 0
    wrong: list[str] = field(default_factory=list)
    printed: dict[int, list[str]] = field(default_factory=dict)

    def to(self, section):
        """Run what is left of the page up to the end of a section."""
        left = blocks(self.page.read_text(encoding="utf-8"))
        last = max(i for i, block in enumerate(left) if block.section == section)
        while self.done <= last:
            self._block(left[self.done])
            self.done += 1

    def _block(self, block):
        if block.title:
            (self.folder / block.title).write_text(block.text, encoding="utf-8")
            return
        commands = block.commands()
        for i, command in enumerate(commands):
            if command.words == "echo $?":
                out, self.code = f"{self.code}\n", 0
            else:
                self.code, out = called(command.words, self.folder)
            self.printed[command.line] = lines = _lines(out)
            at = f"{self.page.name}:{command.line}: $ {command.words}"
            if not same(command.shown, lines):
                now = "\n".join(difflib.ndiff(command.shown, lines))
                self.wrong.append(f"{at}\n{now}")
            asked = i + 1 < len(commands) and commands[i + 1].words == "echo $?"
            if self.code and not asked:
                self.wrong.append(f"{at}\nended with {self.code}\n{out}")


RECORDINGS = {"xsens_acc.mat": "xsens", "imu0.log": "mpu9150"}
"""Real recordings that pages may use, which are not in the repository."""


def lend(folder):
    """Lay the real recordings into a folder, those that are there."""
    for name, where in RECORDINGS.items():
        source = places.RECORDINGS / where / name
        if source.is_file():
            (Path(folder) / name).symlink_to(source)


def called(words, folder):
    """Exit code and output of a command; one of simval runs in this process."""
    head, tail = re.fullmatch(r"([^|>]*)(.*)", words, re.S).groups()
    with contextlib.chdir(folder):
        if head.split()[0] != "simval":
            done = _shell(words)
            return done.returncode, done.stdout
        out, err = io.StringIO(), io.StringIO()
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            code = run(_quick(head))
        text = out.getvalue()
        if tail:
            done = _shell(f"cat {tail}", text)
            text = done.stdout
            code = code if tail.startswith(">") else done.returncode  # as a shell does
        return code, text + err.getvalue() * (code == 2)


def _quick(head):
    words = shlex.split(head)[1:]
    # the numbers are the same for any number of processes, and one needs not be started
    return [*words, "--workers", "1"] if words[0] == "sweep" else words


def _shell(words, text=None):
    here = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    return subprocess.run(
        words,
        shell=True,
        input=text,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        env={**os.environ, "PATH": here},
        check=False,
    )


def same(shown, printed):
    """Whether the lines of a page are those that were printed, by the rule above."""
    if LEFT_OUT not in shown:
        return len(shown) == len(printed) and all(map(_same, shown, printed))
    at = shown.index(LEFT_OUT)
    if len(printed) < at or not all(map(_same, shown[:at], printed)):
        return False
    rest = shown[at + 1 :]
    return not rest or any(same(rest, printed[i:]) for i in range(at, len(printed)))


def _same(line, other):
    line, other = (TOOK.sub("", each) for each in (line, other))
    if _words(line) != _words(other):
        return False
    return all(map(_close, NUMBER.findall(line), NUMBER.findall(other)))


def _lines(text):
    return [line.rstrip() for line in text.rstrip("\n").splitlines()]


def _words(line):
    return " ".join(re.sub(r"([─═-])\1+", r"\1", NUMBER.sub("#", line)).split())


def _close(text, other):
    a, b = (float(t.replace("−", "-")) for t in (text, other))
    if a == b or max(abs(a), abs(b)) < ROUNDING:
        return True
    return abs(a - b) <= 1.0001 * max(_unit(text), _unit(other))


def _unit(text):
    # of the last printed digit; a whole number has none that may differ
    digits, _, power = text.partition("e")
    _, point, decimals = digits.partition(".")
    return 10.0 ** (int(power or 0) - len(decimals)) if point or power else 0.0


def rewritten(walk):
    """The page with what its commands print now; lines left out stay left out."""
    text = walk.page.read_text(encoding="utf-8").splitlines()
    for block in reversed(blocks("\n".join([*text, ""]))):
        if block.language != "console":
            continue
        for command in reversed(block.commands()):
            end = _end(text, command.line)
            start = end - len(command.shown)
            now = _kept(command.shown, walk.printed[command.line])
            text[start:end] = now
    return "\n".join(text) + "\n"


def _end(text, line):
    # the first line after a command's output
    while text[line] != "```" and not text[line].startswith("$ "):
        line += 1
    return line


def _kept(shown, printed):
    if same(shown, printed) or LEFT_OUT not in shown:
        return list(shown) if same(shown, printed) else printed
    now, at = [], 0
    for line in shown:
        words = _words(line)
        found = [i for i in range(at, len(printed)) if _words(printed[i]) == words]
        if line == LEFT_OUT:
            now.append(line)
        elif found:
            now.append(printed[found[0]])
            at = found[0] + 1
        else:
            now.append(f"GONE: {line}")
    return now


def draw(walk):
    """Draw the pictures of a page: the first screen of each file, in a browser."""
    found = PICTURE.findall(walk.page.read_text(encoding="utf-8"))
    with tempfile.TemporaryDirectory() as folder, browser(folder) as shown:
        for picture, file in found:
            shown.open(walk.folder / file, width=1000, height=760)
            taken = shown.call("Page.captureScreenshot", format="webp", quality=80)
            (walk.page.parent / picture).write_bytes(base64.b64decode(taken["data"]))


def main(pages):
    for name in pages:
        page = Path(name).resolve()
        with tempfile.TemporaryDirectory() as folder:
            lend(folder)
            walk = Walk(page, Path(folder))
            for block in blocks(page.read_text(encoding="utf-8")):
                walk.to(block.section)
            page.write_text(rewritten(walk), encoding="utf-8")
            if find_chromium():
                draw(walk)
            sys.stdout.write("\n".join([*walk.wrong, f"{name}: written", ""]))


if __name__ == "__main__":
    main(sys.argv[1:])
