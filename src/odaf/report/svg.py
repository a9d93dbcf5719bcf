"""Matplotlib figures as SVG that lives inside a page: its colours, its font, no address of anything outside."""

import io
import re
from typing import Any

import matplotlib
from markupsafe import Markup, escape
from matplotlib.figure import Figure

from odaf.report.drawing import LIGHT, Palette

# Colours that no drawing uses, each standing for a variable of the style sheet. They are given to the drawing functions
# and exchanged afterwards, so that one drawing serves light pages, dark pages and paper.
_VARIABLES = {
    "ink": "#010a01",
    "muted": "#010a02",
    "grid": "#010a03",
    "surface": "#010a04",
    "wall": "#010a05",
    "data": "#010a06",
    "allowed": "#010a07",
    "stitched": "#010a08",
    "detour": "#010a09",
}
_METHODS = tuple(f"#010b{index:02x}" for index in range(len(LIGHT.methods)))

THEMED = Palette(methods=_METHODS, **_VARIABLES)
"""Colours by purpose whose meaning the page's style sheet decides."""

_NUMBER = re.compile(r"-?\d+\.\d{3,}")
_TAG = re.compile(r"<[^>]*>")


def variables(palette: Palette) -> str:
    """The style sheet's declarations of all colours."""
    named = [f"--{name}: {getattr(palette, name)};" for name in _VARIABLES]
    return " ".join(named + [f"--method-{index}: {colour};" for index, colour in enumerate(palette.methods)])


def to_svg(figure: Figure, name: str, title: str) -> Markup:
    """The figure as an inline SVG element without a size of its own.

    Args:
        figure: drawn with `THEMED`.
        name: unique within the page; parts that refer to one another are named after it.
        title: what the picture shows, for readers who do not see it.
    """
    settings: dict[Any, Any] = {
        "svg.fonttype": "none",  # text stays text
        "svg.hashsalt": name,
        "path.simplify": True,
        "path.simplify_threshold": 0.25,
    }
    target = io.StringIO()
    with matplotlib.rc_context(settings):
        figure.savefig(target, format="svg", transparent=True, metadata={"Date": None, "Creator": None})
    text = target.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    text = re.sub(r"<!--.*?-->", "", text, flags=re.DOTALL)
    text = _TAG.sub(_clean_tag, text)
    text = re.sub(r">\s+<", "><", text)
    return Markup(text.replace("<svg", f'<svg role="img" aria-label="{escape(title)}"', 1))


def _clean_tag(match: re.Match[str]) -> str:
    tag = match.group(0)
    if tag.startswith("<svg"):
        box = re.search(r'viewBox="[^"]*"', tag)
        return f"<svg {box.group(0) if box else ''}>"
    if tag.startswith("<g "):
        tag = re.sub(r' id="[^"]*"', "", tag)
    tag = _NUMBER.sub(lambda number: f"{float(number.group(0)):.2f}".rstrip("0").rstrip("."), tag)
    tag = re.sub(r"\s+", " ", tag)
    tag = re.sub(r"font: ([^;\"']*?)([\d.]+)px [^;\"]*", r"font: \1\2px var(--sans)", tag)
    for variable, colour in _VARIABLES.items():
        tag = tag.replace(colour, f"var(--{variable})")
    for index, colour in enumerate(_METHODS):
        tag = tag.replace(colour, f"var(--method-{index})")
    return tag
