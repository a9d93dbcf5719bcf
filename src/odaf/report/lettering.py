"""Room for words in a picture: how wide they are, how they are broken into lines, and how names are kept apart."""

import bisect
import functools
import re
from collections.abc import Sequence

import numpy as np
from matplotlib.font_manager import FontProperties
from matplotlib.textpath import text_to_path

_PARTS = re.compile(r"(?<=[_./-])")  # where a word may be broken

LINE = 1.25
"""Height of a line in sizes of its letters."""


@functools.lru_cache(maxsize=1024)
def width_of(text: str, size: float, bold: bool = False) -> float:
    """Points that a line takes in Matplotlib's own font, which is wider than those of most screens."""
    font = FontProperties(size=size, weight="bold" if bold else "normal")
    return float(text_to_path.get_text_width_height_descent(text, font, ismath=False)[0])


def fitted(text: str, width: float, size: float, bold: bool = False, lines: int = 6) -> str:
    """The text broken into lines no wider than `width` points, between words where that is possible.

    What does not fit into so many `lines` is left out in the middle, where an ellipsis stands.
    """

    def shortened(left_out: int) -> list[str]:
        kept = len(text) - left_out
        middle = f"{text[: kept - kept // 2]}…{text[len(text) - kept // 2 :]}" if left_out else text
        return _broken(middle, width, size, bold)

    # The fewest letters whose absence makes it fit; at least one at either end stays.
    choices = range(max(len(text) - 1, 1))
    found = shortened(bisect.bisect_left(choices, True, key=lambda left_out: len(shortened(left_out)) <= lines))
    return "\n".join(found)


def _broken(text: str, width: float, size: float, bold: bool) -> list[str]:
    def fits(line: str) -> bool:
        return bool(width_of(line, size, bold) <= width)

    found = [""]
    for word in text.split():
        if fits(f"{found[-1]} {word}".strip()):
            found[-1] = f"{found[-1]} {word}".strip()
            continue
        if found[-1]:
            found.append("")
        for part in _PARTS.split(word):
            for letters in [part] if fits(part) else part:
                if found[-1] and not fits(found[-1] + letters):
                    found.append("")
                found[-1] += letters
    return found


def spread_out(wanted: Sequence[float], gap: float, low: float, high: float) -> list[float]:
    """Places near the wanted ones, in the same order, at least `gap` apart and, as far as they fit, within bounds.

    The sum of squared distances from the wanted places is the least possible before the bounds are kept.
    """
    from scipy.optimize import isotonic_regression

    order = np.argsort(wanted, kind="stable")
    steps = gap * np.arange(len(order))
    free = np.asarray(isotonic_regression(np.asarray(wanted, np.float64)[order] - steps).x)
    places = np.empty(len(order))
    places[order] = np.clip(free, low, max(high - (steps[-1] if len(steps) else 0.0), low)) + steps
    return places.tolist()
