"""The documentation as a site: public names have a place, pages are in the contents, nothing comes from elsewhere."""

import importlib
import pkgutil
import re
import sys
from pathlib import Path

import pytest
import yaml

import odaf

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from tools import offline  # noqa: E402

API = ROOT / "docs" / "reference" / "api"
ROOMS = ("data", "environments", "evaluation", "report", "training")


def documented() -> list[str]:
    """What the pages of the API show, by the names that they show it under."""
    return [name for page in API.glob("*.md") for name in re.findall(r"^::: (\S+)$", page.read_text(), re.MULTILINE)]


def test_every_public_name_is_on_a_page_of_the_api():
    names = documented()
    assert len(names) == len(set(names)), "a name is shown twice"
    missing = {f"odaf.{name}" for name in odaf.__all__ if name != "__version__"} - set(names)
    assert not missing
    shown = {id(pkgutil.resolve_name(name)) for name in names}
    for room in ROOMS:
        module = importlib.import_module(f"odaf.{room}")
        missing = {f"odaf.{room}.{name}" for name in module.__all__ if id(getattr(module, name)) not in shown}
        assert not missing


def test_every_page_is_in_the_contents():
    def pages(entries: list) -> list[str]:
        found = []
        for entry in entries:
            (value,) = entry.values() if isinstance(entry, dict) else (entry,)
            found += pages(value) if isinstance(value, list) else [value]
        return found

    contents = pages(yaml.safe_load((ROOT / "mkdocs.yml").read_text(encoding="utf-8"))["nav"])
    docs = ROOT / "docs"
    assert sorted(contents) == sorted(str(page.relative_to(docs)) for page in docs.rglob("*.md"))


LOADS = {
    '<script src="https://unpkg.com/a.js"></script>': "https://unpkg.com/a.js",
    '<link rel="stylesheet" href="//fonts.example/css">': "//fonts.example/css",
    '<link rel="preconnect" href="https://fonts.example">': "https://fonts.example",
    '<img alt="" src="https://badges.example/ci.svg">': "https://badges.example/ci.svg",
    '<img alt="" srcset="a.png 1x, https://b.example/b.png 2x">': "https://b.example/b.png",
    '<p style="background: url(http://c.example/c.png)">': "http://c.example/c.png",
    "<style>@import 'https://d.example/d.css';</style>": "https://d.example/d.css",
    '<iframe src="https://e.example"></iframe>': "https://e.example",
    '<svg><use href="https://f.example/f.svg#a"></use></svg>': "https://f.example/f.svg#a",
    '<meta http-equiv="refresh" content="0; url=https://g.example">': "https://g.example",
    '<img alt="" src="missing.png">': "missing.png",
}


@pytest.mark.parametrize("text", LOADS)
def test_what_a_page_would_load_is_found(text: str, tmp_path: Path):
    (tmp_path / "a.png").touch()
    (tmp_path / "index.html").write_text(text)
    (fault,) = offline.faults(tmp_path)
    assert f"loads {LOADS[text]}" in fault


def test_a_site_of_its_own_files_is_fit_to_be_read_without_a_network(tmp_path: Path):
    (tmp_path / "a.css").write_text("body { background: url('a.png') } i { mask: url(data:image/svg+xml,%3csvg/%3e) }")
    (tmp_path / "a.png").touch()
    (tmp_path / "a.js").write_text("/* https://credits.example */ let a = 1")
    (tmp_path / "index.html").write_text(
        '<link rel="stylesheet" href="a.css?v=1"><script src="./a.js"></script><a href="https://reader.example">x</a>'
        '<link rel="canonical" href="https://home.example"><img alt="" src="data:image/png;base64,">'
    )
    assert offline.faults(tmp_path) == []
    (tmp_path / "a.js").write_text("fetch('https://elsewhere.example/x.js')")
    (tmp_path / "more.css").write_text("@font-face { src: url(https://fonts.example/f.woff2) }")
    (tmp_path / "more.html").write_text('<pre class="mermaid">graph</pre>')
    text = "\n".join(offline.faults(tmp_path))
    assert all(part in text for part in ("elsewhere.example", "fonts.example", "Mermaid"))
    assert offline.faults(tmp_path / "nowhere")
