"""The documentation does what it says: Python examples run, commands and their options exist, links lead somewhere."""

import json
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import jax
import pytest

import odaf
from odaf.cli.dispatch import find_command, main
from odaf.environments import stitch_data

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

from tools import drawn  # noqa: E402

PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
NAMES = [str(page.relative_to(ROOT)) for page in PAGES]

_BLOCK = re.compile(r"^```(\w+)\n(.*?)^```", re.MULTILINE | re.DOTALL)
_LINK = re.compile(r"\[[^\]]*\]\(([^)\s#]+)(?:#[^)]*)?\)|<img[^>]+src=\"([^\"]+)\"")


def blocks(page: Path, language: str) -> list[tuple[int, str]]:
    """Line number and text of each fenced block of one language."""
    text = page.read_text(encoding="utf-8")
    return [(text.count("\n", 0, m.start()) + 2, m[2]) for m in _BLOCK.finditer(text) if m[1] == language]


def commands(page: Path) -> list[tuple[int, list[str]]]:
    """Line number and words of every `odaf ...` in the page's shell blocks; a backslash continues a line."""
    return [(line, words[1:]) for line, words in shell_lines(page) if words[0] == "odaf"]


def shell_lines(page: Path) -> list[tuple[int, list[str]]]:
    """Line number and words of every command in the page's shell blocks, comments aside."""
    found = []
    for first, text in blocks(page, "sh"):
        # A continued line keeps its number, and those that it goes on in become empty.
        joined = re.sub(r"(?:.*\\\n)+.*", lambda m: m[0].replace("\\\n", " ") + "\n" * m[0].count("\n"), text)
        for offset, line in enumerate(joined.splitlines()):
            if words := shlex.split(line, comments=True):
                found.append((first + offset, words))
    return found


def make_runs() -> None:
    """The runs that pages speak of, in the working directory: small ones, all of the method that is trained soonest."""
    log = stitch_data.generate(stitch_data.CONFIGS["stitch"].with_repeats(1), seed=0)
    learner = odaf.BehaviourCloning(hidden_sizes=(8,), batch_size=8)
    for name in ("odaf", "behaviour-cloning"):
        directory = Path("runs") / name
        odaf.fit(
            learner, log, steps=4, directory=directory, evaluate=odaf.Rollouts(episodes=2), preset=name, progress=False
        )


TUTORIALS = ROOT / "docs" / "tutorials"
# On these pages the commands are part of the program: they run between the blocks of Python, those of a C compiler
# too. A block of C whose first line is the comment of a file's name is that file.
WITH_COMMANDS = (TUTORIALS / "plant.md", TUTORIALS / "guarded-c.md", TUTORIALS / "which-run.md")
# What they train and fit is made small; the last word of an option counts.
SMALL = ("--steps", "4", "--hidden-sizes", "8", "--batch-size", "8", "--no-compilation-cache", "--quiet")
SHORTER = {
    "train behaviour-cloning": SMALL,
    "train rebrac": SMALL,
    "train odaf": (
        *(*SMALL, "--num-critics", "2"),
        *("--outcome.dynamics.steps", "4", "--outcome.dynamics.hidden-sizes", "8"),
    ),
    "guard": ("--steps", "4", "--references", "16"),
    "select": ("--steps", "4", "--members", "2"),
    "assess": ("--steps", "4", "--members", "2"),
}


@contextmanager
def compiled_quickly() -> Iterator[None]:
    """Programs that run for a moment are not worth the compiler's pains."""
    before = jax.config.read("jax_disable_most_optimizations")
    jax.config.update("jax_disable_most_optimizations", True)
    try:
        yield
    finally:
        jax.config.update("jax_disable_most_optimizations", before)


def run_words(words: list[str]) -> int:
    """Exit status of a command line of a page, made small."""
    if words[0] == "odaf":
        name = " ".join(words[1:3]) if words[1] == "train" else words[1]
        return main([*words[1:], *SHORTER.get(name, ())])
    optimised = [word.replace("-O3", "-O1") for word in words]
    return subprocess.run(optimised, check=False).returncode


@pytest.mark.parametrize("page", [p for p in PAGES if blocks(p, "python")], ids=lambda p: str(p.relative_to(ROOT)))
def test_examples_run(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """The blocks of one page are one program, run where it can leave files."""
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {"__name__": "example"}
    if any('Path("runs/odaf")' in text for _, text in blocks(page, "python")):
        make_runs()
    program: list[tuple[int, str | list[str]]] = [*blocks(page, "python")]
    if page in WITH_COMMANDS:
        program += shell_lines(page)
        for _, text in blocks(page, "c"):
            Path(text.split("\n", 1)[0].strip("/* ")).write_text(text, encoding="utf-8")
        if shutil.which("cc") is None and any(words[0] == "cc" for _, words in shell_lines(page)):
            pytest.skip("needs a C compiler")
    with compiled_quickly():
        for line, step in sorted(program, key=lambda part: part[0]):
            if isinstance(step, list):
                assert run_words(step) == 0, f"{page}:{line}"
            else:
                # Blank lines in front make a traceback name the line of the page.
                exec(compile("\n" * (line - 1) + step, str(page), "exec"), names)


def test_the_readme_has_an_example_and_it_is_short():
    found = blocks(ROOT / "README.md", "python")
    assert len(found) == 1
    assert len(found[0][1].splitlines()) <= 20


@pytest.mark.parametrize("page", PAGES, ids=NAMES)
def test_commands_and_their_options_exist(page: Path, capsys: pytest.CaptureFixture[str]):
    helps: dict[str, str] = {}
    for line, words in commands(page):
        command, rest = find_command(words)
        if command is None:
            assert words in (["--help"], ["--version"]), f"{page}:{line}: odaf {' '.join(words)}: no such command"
            continue
        name = command.name.split()
        if command.name == "train":
            name, rest = [*name, rest[0]], rest[1:]
        if (key := " ".join(name)) not in helps:
            assert main([*name, "--help"]) == 0, f"{page}:{line}: odaf {key}"
            helps[key] = capsys.readouterr().out
        for word in rest:
            if word.startswith("--") and word not in ("--help", "--debug"):
                assert re.search(rf"{re.escape(word)}[\s,]", helps[key]), f"{page}:{line}: odaf {key} has no {word}"


@pytest.mark.parametrize("page", PAGES, ids=NAMES)
def test_links_to_files_lead_somewhere(page: Path):
    for match in _LINK.finditer(page.read_text(encoding="utf-8")):
        target = match[1] or match[2]
        if "://" not in target and not target.startswith("mailto:"):
            assert (page.parent / target).exists(), f"{page} links to {target}, which is not there"


def test_pages_that_code_names_are_there():
    """Help texts, messages and docstrings send readers to pages by their path in the project's folder."""
    named = 0
    for path in [path for folder in ("src", "benchmarks", "tools", "tests") for path in (ROOT / folder).rglob("*.*")]:
        if path.suffix in (".py", ".toml"):
            for page in re.findall(r"docs/[\w/-]+\.md", path.read_text(encoding="utf-8")):
                assert (ROOT / page).is_file(), f"{path} names {page}, which is not there"
                named += 1
    assert named > 20


def test_the_maze_on_the_page_can_be_recorded():
    (_, text), *_ = blocks(ROOT / "docs" / "how-to" / "record-data.md", "json")
    config = stitch_data.StitchConfig.from_dict(json.loads(text))
    assert sum(route.repeats for route in config.routes) == 200


def test_parts_that_studies_draw_are_what_the_ledgers_say() -> None:
    assert len(drawn.pages()) >= 2
    for page in drawn.pages():
        text = page.read_text(encoding="utf-8")
        assert drawn.drawn(text) == text, f"{page}: draw it again with `make drawn`"
