"""The page "Is my log usable?" has every check by its name, and none that does not exist."""

import re
from pathlib import Path

import odaf

ROOT = Path(__file__).parents[3]
SOURCES = sorted((Path(odaf.__file__).parent / "data" / "checks").rglob("*.py"))


def test_the_page_names_every_check():
    code = "\n".join(path.read_text(encoding="utf-8") for path in SOURCES)
    names = set(re.findall(r'Finding\(\s*"([a-z-]+)"', code))
    page = (ROOT / "docs" / "reference" / "checks.md").read_text(encoding="utf-8")
    rows = [line.split("|")[1] for line in page.splitlines() if line.startswith("| `")]
    documented = {name for row in rows for name in re.findall(r"`([a-z-]+)`", row)}
    assert len(names) > 35
    assert names - documented == {"known-file"}  # says that all is well
    assert documented <= names
