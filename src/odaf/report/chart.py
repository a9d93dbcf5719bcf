"""One picture of the page and how it is made."""

from collections.abc import Callable
from dataclasses import dataclass

from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from odaf.report.svg import to_svg

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


def chart_svg(
    name: str,
    title: str,
    size: tuple[float, float],
    draw: Callable[[Axes], None],
    margins: tuple[float, float, float, float] = (0.42, 0.06, 0.42, 0.1),
) -> Markup:
    """Draws on an axes of `size` inches and returns it for the page.

    Args:
        name: unique within the page.
        title: what the picture shows, for readers who do not see it.
        size: width and height, inches.
        draw: draws on the axes it is given.
        margins: left, right, bottom and top of the axes, inches. Fixed ones align neighbouring pictures, and spare the
            measuring of every text, which takes longer than the drawing.
    """
    figure = Figure(figsize=size, dpi=72)
    left, right, bottom, top = margins
    width, height = size
    box = (left / width, bottom / height, 1 - (left + right) / width, 1 - (bottom + top) / height)
    draw(figure.add_axes(box))
    return to_svg(figure, name, title)
