"""Pictures of studies are written, with as many panels as there is to show."""

from pathlib import Path

import pytest

from odaf.report.study_figures import Bar, Cloud, Line, bars_figure, clouds_figure, lines_figure

pytest.importorskip("matplotlib")


def test_bars_lines_and_clouds_are_pictures_that_are_the_same_again(tmp_path: Path) -> None:
    def draw(folder: Path) -> list[bytes]:
        bars_figure({"a": [Bar("x", 1.0, [0.5, 1.5]), Bar("y", 2.0)]}, folder / "bars.png", "title", "note")
        lines = [Line("x", [0, 1, 2], [[1.0, 2.0], [], [3.0]]), Line("nothing", [0, 1, 2], [[], [], []])]
        lines_figure(
            {"a": lines, "b": lines}, folder / "lines.png", "title", "note", "across", "up", {"a": [("log", 1.5)]}
        )
        cloud = Cloud([0.0, 0.0], [1.0, 1.0], [[1, 0], [3, 2]], {"x": [[0.5, 0.5], [9.0, 9.0]]})
        clouds_figure({"a": cloud}, folder / "clouds.png", "title", "note")
        return [(folder / f"{name}.png").read_bytes() for name in ("bars", "lines", "clouds")]

    first = draw(tmp_path / "first")
    assert all(each.startswith(b"\x89PNG") for each in first) and first == draw(tmp_path / "second")
