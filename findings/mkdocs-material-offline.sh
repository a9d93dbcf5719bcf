#!/bin/bash
# The `offline` plugin of mkdocs-material makes every page load a script from another server.
#
# Expected: a site built with the plugin, which is there to read the documentation from disk, asks no server for anything.
# Seen: the plugin itself puts https://unpkg.com/iframe-worker/shim (of no version) into every page, as an ordinary script. The same
# site built without the plugin, with the theme's web fonts off in both, loads nothing from elsewhere. The page of the plugin speaks
# of a search that works without a server; the script is part of that.
#
# Why it matters: documentation of a package for plants and laboratories is read on machines without a network, where each page then
# waits for that server and its search fails, or on machines with one, where it tells another company who reads what.
#
# odaf names a script of its own under `extra.polyfills` (a name with "iframe-worker" in it stops the plugin from adding its own), and
# `python -m tools.offline site`, a part of `make docs`, fails where a page would load something.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/python" -m pip install -qq --disable-pip-version-check mkdocs==1.6.1 mkdocs-material==9.8.2
mkdir "$work/docs"
echo '# Start' > "$work/docs/index.md"
echo '# Another page' > "$work/docs/other.md"
echo "mkdocs 1.6.1, mkdocs-material 9.8.2; scripts, styles and pictures that pages load from elsewhere"
for plugins in "search" "search, offline"; do
    cat > "$work/mkdocs.yml" <<YAML
site_name: notes
use_directory_urls: false
theme: { name: material, font: false }
plugins: [$plugins]
YAML
    NO_MKDOCS_2_WARNING=1 "$work/venv/bin/python" -m mkdocs build -q -f "$work/mkdocs.yml" -d "$work/site"
    "$work/venv/bin/python" - "$work/site" "$plugins" <<'PYTHON'
import sys
from html.parser import HTMLParser
from pathlib import Path

site, plugins = Path(sys.argv[1]), sys.argv[2]
found = []


class Loads(HTMLParser):
    def handle_starttag(self, tag, attrs):
        given = dict(attrs)
        loaded = given.get("href") if tag == "link" and given.get("rel") != "canonical" else given.get("src")
        if (loaded or "").startswith(("http:", "https:", "//")):
            found.append((tag, loaded))


pages = sorted(site.rglob("*.html"))
for page in pages:
    Loads().feed(page.read_text(encoding="utf-8"))
print(f"  plugins {plugins}: expected none; seen {len(found)} on {len(pages)} pages {sorted(set(found)) or ''}")
if found != ([("script", "https://unpkg.com/iframe-worker/shim")] * len(pages) if "offline" in plugins else []):
    sys.exit("stale: the pages load something else")
PYTHON
done
