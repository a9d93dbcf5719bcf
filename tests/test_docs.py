"""The documentation does what it says: Python examples run, commands and their options exist, links lead somewhere."""

import json
import re
import shlex
from pathlib import Path

import pytest

import odaf
from odaf.cli.dispatch import find_command, main
from odaf.environments import stitch_data

ROOT = Path(__file__).parents[1]
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
    found = []
    for first, text in blocks(page, "sh"):
        for offset, line in enumerate(text.replace("\\\n", " ").splitlines()):
            if line.startswith("odaf "):
                found.append((first + offset, shlex.split(line, comments=True)[1:]))
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


# On these pages the commands are part of the program: they run between the blocks of Python.
WITH_COMMANDS = (ROOT / "docs" / "tutorials" / "plant.md",)
# What they train is made small; the last word of an option counts.
SHORTER = {
    "behaviour-cloning": ["--steps", "4", "--hidden-sizes", "8", "--batch-size", "8"],
    "odaf": [
        *("--steps", "4", "--hidden-sizes", "8", "--batch-size", "8", "--num-critics", "2"),
        *("--outcome.dynamics.steps", "4", "--outcome.dynamics.hidden-sizes", "8"),
    ],
}


@pytest.mark.parametrize("page", [p for p in PAGES if blocks(p, "python")], ids=lambda p: str(p.relative_to(ROOT)))
def test_examples_run(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """The blocks of one page are one program, run where it can leave files."""
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {"__name__": "example"}
    if any('Path("runs/odaf")' in text for _, text in blocks(page, "python")):
        make_runs()
    program = [(line, text, None) for line, text in blocks(page, "python")]
    if page in WITH_COMMANDS:
        program += [(line, "", words) for line, words in commands(page)]
    for line, text, words in sorted(program, key=lambda part: part[0]):
        if words is not None:
            shorter = [*SHORTER[words[1]], "--no-compilation-cache", "--quiet"] if words[0] == "train" else []
            assert main([*words, *shorter]) == 0, f"{page}:{line}"
        else:
            # Blank lines in front make a traceback name the line of the page.
            exec(compile("\n" * (line - 1) + text, str(page), "exec"), names)


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
