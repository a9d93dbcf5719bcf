"""Parts of documentation pages that a study draws: `make drawn` puts in what the ledgers say now.

A part stands between `<!-- drawn: results/FILE -->` and `<!-- end of drawn -->`; the tests compare.
"""

import re
from pathlib import Path

ROOT = Path(__file__).parents[1]
_PART = re.compile(r"(<!-- drawn: (results/\S+) -->\n)(.*?)(<!-- end of drawn -->)", re.DOTALL)


def pages() -> list[Path]:
    """Every page of the documentation that has such a part."""
    return [page for page in sorted((ROOT / "docs").rglob("*.md")) if _PART.search(page.read_text(encoding="utf-8"))]


def drawn(text: str) -> str:
    """A page's text with its parts as the files say them."""

    def part(found: re.Match[str]) -> str:
        return f"{found[1]}\n{(ROOT / found[2]).read_text(encoding='utf-8')}\n{found[4]}"

    return _PART.sub(part, text)


if __name__ == "__main__":
    for page in pages():
        page.write_text(drawn(page.read_text(encoding="utf-8")), encoding="utf-8")
        print(f"wrote {page.relative_to(ROOT)}")
