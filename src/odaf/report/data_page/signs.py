"""Pictures of signs that a log cannot teach what is asked, one for each that the checks found."""

import numpy as np
from matplotlib.axes import Axes

from odaf.data import Dataset
from odaf.data.checks.signs import Conflict, CopiedAction, CopiedReward, Effects, LonelyEpisodes, Signs
from odaf.report.chart import NARROW, Chart, chart_svg
from odaf.report.drawing import Palette, plain_number, short_values, style_axes
from odaf.report.svg import THEMED

_HEIGHT = 2.4
_MARGINS = (0.55, 0.08, 0.42, 0.1)
MOST_LINES = 4


def sign_charts(dataset: Dataset, signs: Signs | None) -> list[Chart]:
    """A picture of each sign, in the order of the findings; none where nothing was found.

    Args:
        dataset: the rows, for names.
        signs: as the report of its checks holds them.
    """
    if signs is None:
        return []
    names, actions = dataset.observation_names, dataset.action_names
    charts = [_copied_action(entry, names, actions, place) for place, entry in enumerate(signs.copied_actions)]
    if signs.copied_reward is not None:
        charts.append(_copied_reward(signs.copied_reward, names, actions))
    if signs.effects is not None:
        charts += _effects(signs.effects, actions)
    if signs.conflict is not None:
        charts.append(_conflict(signs.conflict, names, actions))
    if signs.lonely is not None:
        charts.append(_lonely(signs.lonely, names))
    return charts


def _copied_action(sign: CopiedAction, names: tuple[str, ...], actions: tuple[str, ...], place: int) -> Chart:
    row = ("the same row", "the next row")[sign.lead]
    column, action = names[sign.column], actions[sign.action]
    svg = chart_svg(
        f"copied-action-{place}", f"Column {column} against action {action}", (NARROW, _HEIGHT),
        lambda axes: dots(axes, THEMED, sign.held, sign.taken, None, column, action), _MARGINS,
    )  # fmt: skip
    return Chart(
        "A column that holds the action", svg,
        f"Each dot is a row: {column}, and the action {action} of {row}. They lie on a line, so the column says the "
        "action before it is taken.",
    )  # fmt: skip


def _copied_reward(sign: CopiedReward, names: tuple[str, ...], actions: tuple[str, ...]) -> Chart:
    column = (actions if sign.field == "actions" else names)[sign.column]
    column = f"next {column}" if sign.field == "next_observations" else column
    svg = chart_svg(
        "copied-reward", f"Reward against {column}", (NARROW, _HEIGHT),
        lambda axes: dots(axes, THEMED, sign.values, sign.rewards, None, column, "reward"), _MARGINS,
    )  # fmt: skip
    return Chart(
        "A reward that one column says", svg,
        f"Each dot is a row: {column}, and its reward. They lie on one curve: nothing else matters to the reward.",
    )  # fmt: skip


def _effects(sign: Effects, actions: tuple[str, ...]) -> list[Chart]:
    late = [action for action in range(len(actions)) if sign.dead_time(action)]
    idle = [action for action in range(len(actions)) if sign.nothing(action)]
    charts = []
    for name, heading, chosen, what in (
        ("dead-time", "Actions that act late", late, "the first rows after an action show nothing of it"),
        ("no-effect", "Actions that change nothing", idle, "all of it lies in the grey band, where chance lies"),
    ):
        if not chosen:
            continue
        svg = chart_svg(
            name, heading, (NARROW, _HEIGHT),
            lambda axes, chosen=chosen: draw_effects(axes, THEMED, sign, chosen[:MOST_LINES]), _MARGINS,
        )  # fmt: skip
        shown = ", ".join(actions[action] for action in chosen[:MOST_LINES])
        charts.append(
            Chart(
                heading, svg,
                f"Correlation of what was free in {shown} with what changed unforeseen so many rows later: {what}.",
            )
        )  # fmt: skip
    return charts


def _conflict(sign: Conflict, names: tuple[str, ...], actions: tuple[str, ...]) -> Chart:
    column, action = names[sign.column], actions[sign.action]
    svg = chart_svg(
        "conflict", f"Action {action} against {column}, by group of episodes", (NARROW, _HEIGHT),
        lambda axes: dots(axes, THEMED, sign.states, sign.taken, sign.of_second, column, action), _MARGINS,
    )  # fmt: skip
    few, many = sorted((len(sign.first), len(sign.second)))
    return Chart(
        "Controllers in conflict", svg,
        f"Each dot is a row, coloured by the group its episode belongs to ({few:,} and {many:,} episodes). In the same "
        f"states the groups' actions lie {plain_number(sign.apart)} apart; inside one they spread by "
        f"{plain_number(sign.within)}.",
    )  # fmt: skip


def _lonely(sign: LonelyEpisodes, names: tuple[str, ...]) -> Chart:
    first, second = (names[column] for column in sign.columns)
    svg = chart_svg(
        "lonely", f"{second} against {first}, lonely episodes marked", (NARROW, _HEIGHT),
        lambda axes: dots(axes, THEMED, sign.points[:, 0], sign.points[:, 1], sign.lonely, first, second), _MARGINS,
    )  # fmt: skip
    return Chart(
        "Where only one episode went", svg,
        f"Each dot is a row; dark ones belong to {len(sign.rows):,} of {sign.of:,} episodes, and no other comes near.",
    )  # fmt: skip


def dots(
    axes: Axes, palette: Palette, across: np.ndarray, up: np.ndarray, marked: np.ndarray | None, below: str, beside: str
) -> None:
    """Rows as dots: pale ones, and above them dark ones where `marked`."""
    marked = np.zeros(len(across), bool) if marked is None else marked
    for chosen, colour, alpha in ((~marked, palette.data, 0.4), (marked, palette.stitched, 0.7)):
        axes.plot(
            across[chosen], up[chosen], linestyle="", marker="o", markersize=2.2, markeredgewidth=0, color=colour,
            alpha=alpha,
        )  # fmt: skip
    axes.set_xlabel(below, fontsize=8).set_parse_math(False)
    axes.set_ylabel(beside, fontsize=8).set_parse_math(False)
    style_axes(axes, palette)
    short_values(axes)


def draw_effects(axes: Axes, palette: Palette, sign: Effects, chosen: list[int]) -> None:
    """Correlations by lag, a line for each action, over the band of chance."""
    lags = np.arange(len(sign.strength))
    axes.axhspan(0, sign.quiet, color=palette.grid, linewidth=0)
    for place, action in enumerate(chosen):
        axes.plot(
            lags, sign.strength[:, action], color=palette.method(place), linewidth=1.4, marker="o", markersize=2.5
        )
    axes.set_ylim(0, max(1.1 * float(sign.strength[:, chosen].max()), 2 * sign.quiet))
    axes.set_xlabel("rows later", fontsize=8)
    axes.set_ylabel("correlation", fontsize=8)
    style_axes(axes, palette)
