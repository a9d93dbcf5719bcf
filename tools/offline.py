"""Fails where a built site loads something over the network, or a file of its own that is not there.

    python -m tools.offline site

Looks at what a browser fetches by itself: scripts, style sheets, images, fonts, frames. A link that a reader may follow
is free to lead anywhere. Scripts are searched for addresses, each of which has to be known here with the reason why it
is never asked for.
"""

import re
import sys
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

# Attributes whose address is fetched, by element; of a `link`, only with one of these relations.
_FETCHED = {"src", "srcset", "poster", "data", "background"}
_REFERENCES = {"use", "image", "feimage"}
_RELATIONS = {"stylesheet", "icon", "preload", "prefetch", "preconnect", "dns-prefetch", "modulepreload", "manifest"}
_STYLE = re.compile(r"@import\s+[\"']([^\"']+)|url\(\s*[\"']?([^\"')]+)")
_ADDRESS = re.compile(r"https?://[^\s\"'`<>)]+")
_COMMENT = re.compile(r"/\*.*?\*/", re.DOTALL)

# Addresses in the theme's scripts, and when they would be fetched.
KNOWN = {
    "https://unpkg.com/mermaid": "for a diagram in Mermaid's language; `_pages` refuses one",
    "https://unpkg.com/resize-observer-polyfill": "in browsers older than 2020",
    "https://bit.ly/2s3ChXG": "part of a message",
    "https://api.github.com/": "for a `repo_url` on GitHub; mkdocs.yml has none",
    "https://${e}/api/v4/projects/": "for a `repo_url` on GitLab; mkdocs.yml has none",
}


class _Loads(HTMLParser):
    """Collects what a page fetches by itself."""

    def __init__(self) -> None:
        super().__init__()
        self.addresses: list[str] = []
        self.diagrams = False
        self._in_style = False

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = {name: value or "" for name, value in attrs}
        self._in_style = tag == "style"
        self.diagrams |= "mermaid" in given.get("class", "").split()
        for name in _FETCHED & given.keys():
            candidates = given[name].split(",") if name == "srcset" else [given[name]]
            self.addresses += [candidate.split()[0] for candidate in candidates if candidate.strip()]
        if tag in _REFERENCES:
            self.addresses += [given[name] for name in ("href", "xlink:href") if name in given]
        if tag == "link" and _RELATIONS & set(given.get("rel", "").lower().split()):
            self.addresses.append(given.get("href", ""))
        if tag == "meta" and given.get("http-equiv", "").lower() == "refresh" and "url=" in given["content"].lower():
            self.addresses.append(re.split("url=", given["content"], flags=re.IGNORECASE)[1])
        self.addresses += _addresses_in_style(given.get("style", ""))

    def handle_data(self, data: str) -> None:
        if self._in_style:
            self.addresses += _addresses_in_style(data)

    def handle_endtag(self, tag: str) -> None:
        self._in_style = False


def faults(site: Path) -> list[str]:
    """What stands in the way of reading the site without a network, a line each."""
    if not (site / "index.html").is_file():
        return [f"{site}: holds no index.html; build the site first"]
    return [*_pages(site), *_styles(site), *_scripts(site)]


def _pages(site: Path) -> Iterator[str]:
    for page in sorted(site.rglob("*.html")):
        loads = _Loads()
        loads.feed(page.read_text(encoding="utf-8"))
        if loads.diagrams:
            yield f"{page}: has a diagram in Mermaid's language, which loads a script from elsewhere"
        # The page for addresses that do not exist is served from any depth, so it names files from the root.
        base = site if page.name == "404.html" else page.parent
        yield from _wrong(page, loads.addresses, base, site)


def _styles(site: Path) -> Iterator[str]:
    for style in sorted(site.rglob("*.css")):
        yield from _wrong(style, _addresses_in_style(style.read_text(encoding="utf-8")), style.parent, site)


def _scripts(site: Path) -> Iterator[str]:
    for script in sorted(site.rglob("*.js")):
        # Not looked at: the text of the pages, and word stems of languages that the site is not in.
        if script.name == "search_index.js" or "lunr" in script.parts:
            continue
        for address in _ADDRESS.findall(_COMMENT.sub("", script.read_text(encoding="utf-8"))):
            if not address.startswith(tuple(KNOWN)):
                yield f"{script}: holds {address}; see whether it is fetched, and say so in tools/offline.py"


def _wrong(file: Path, addresses: list[str], base: Path, site: Path) -> Iterator[str]:
    for address in addresses:
        parts = urlsplit(address)
        if parts.scheme == "data" or not (parts.scheme or parts.netloc or parts.path):
            continue
        if parts.scheme or parts.netloc:
            yield f"{file}: loads {address}"
            continue
        path = unquote(parts.path)
        place = site / path.lstrip("/") if path.startswith("/") else base / path
        if not place.exists():
            yield f"{file}: loads {address}, which is not there"


def _addresses_in_style(text: str) -> list[str]:
    return [first or second for first, second in _STYLE.findall(text)]


if __name__ == "__main__":
    found = faults(Path(sys.argv[1] if len(sys.argv) > 1 else "site"))
    print("\n".join(found) or "the site loads nothing from elsewhere", file=sys.stderr if found else sys.stdout)
    sys.exit(bool(found))
