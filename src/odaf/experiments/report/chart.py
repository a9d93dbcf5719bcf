"""One picture of the page and how it is made."""

from collections.abc import Callable
from dataclasses import dataclass

from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from odaf.experiments.report.svg import to_svg

WIDE, NARROW = 4.7, 3.3  # inches; text has the same size on the page because narrow pictures stand side by side


@dataclass(frozen=True)
class Chart:
    """A picture of the page.

    Attributes:
        heading: short, may be empty.
        svg: the picture.
        caption: what to see.
        index: the method it is about, `None` for several.
    """

    heading: str
    svg: Markup
    caption: str
    index: int | None = None


def chart_svg(name: str, title: str, size: tuple[float, float], draw: Callable[[Axes], None]) -> Markup:
    """Draws on an axes of `size` inches and returns it for the page; `name` must be unique, `title` says what it is."""
    figure = Figure(figsize=size, dpi=72, layout="constrained")
    figure.get_layout_engine().set(w_pad=0.02, h_pad=0.02)  # type: ignore[union-attr]
    draw(figure.add_subplot())
    return to_svg(figure, name, title)
