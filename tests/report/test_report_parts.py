"""What the report is made of: reading, scores, settings, mazes, curves, and picture files."""

import dataclasses
import json

import numpy as np
import pytest
from markupsafe import Markup
from matplotlib.figure import Figure
from matplotlib.image import imread
from matplotlib.patches import Rectangle
from matplotlib.text import Text

from golden.runs import dataset_of
from odaf.errors import ConfigError
from odaf.report import chart, charts, drawing, figures, lettering, page, paths
from odaf.report.configuration import differences, flatten
from odaf.report.data_page import pictures
from odaf.report.layout import maze_layout
from odaf.report.names import names_of
from odaf.report.quantities import Curve, Trajectories
from odaf.report.records import Evaluation, read_run
from odaf.report.scores import episode_std, headline_index, score

MAZE = {
    "name": "pointmaze",
    "maze": {
        "name": "stitch",
        "rows": ["111111", "100111", "100001", "111111"],
        "start": [1, 2],
        "goal": [2, 4],
        "avoid": [[1, 1], [2, 1]],
    },
}


@pytest.fixture(scope="module")
def runs(tmp_path_factory, run_writer):
    folder = tmp_path_factory.mktemp("runs")
    return [
        run_writer(folder / "odaf", "odaf", 121.0, 0.8),
        run_writer(folder / "cloned", "behaviour-cloning", 41.0, 0.1, seeds=(0,), critic=False),
    ]


def evaluated(step, mean, std, returns=None):
    returns = None if returns is None else np.asarray(returns, np.float64)
    return Evaluation(step, mean, std, 2, None, None, returns)


def test_spread_over_episodes_is_pooled_over_seeds():
    # Seeds (1, 3) and (5, 7): the four returns have mean 4 and variance (9 + 1 + 1 + 9) / 4 = 5.
    kept = [evaluated(1, 2.0, 1.0, [1, 3]), evaluated(1, 6.0, 1.0, [5, 7])]
    assert episode_std(kept) == pytest.approx(np.sqrt(5.0))
    without_returns = [evaluated(1, 2.0, 1.0), evaluated(1, 6.0, 1.0)]
    assert episode_std(without_returns) == pytest.approx(np.sqrt(5.0))


def test_score_reads_the_files_of_a_run(runs):
    entry = score(read_run(runs[0]), "odaf")
    summaries = [json.loads((runs[0] / f"seed-{seed}" / "summary.json").read_text()) for seed in (0, 1)]
    assert entry.seed_means == tuple(summary["evaluation"]["mean_return"] for summary in summaries)
    assert (entry.seeds, entry.evaluated, entry.episodes, entry.step) == (2, 2, 100, 20000)
    assert entry.stitched_rate == pytest.approx(0.8)
    assert entry.train_seconds == pytest.approx(325.5)
    assert entry.status == "finished"
    assert score(read_run(runs[1]), "cloned").interval is None


def test_unfinished_seed_is_scored_by_its_newest_evaluation(run_writer, tmp_path):
    run = run_writer(tmp_path / "run", seeds=(3,))
    summary = json.loads((run / "seed-3" / "summary.json").read_text())
    summary |= {"status": "running", "evaluation": {"step": 5000, "mean_return": 1.0, "episodes": 50}}
    (run / "seed-3" / "summary.json").write_text(json.dumps(summary))
    seed = read_run(run).seeds[0]
    assert seed.status == "unfinished"
    assert seed.evaluation is not None and seed.evaluation.step == 20000
    assert seed.evaluation.mean > 100


def test_later_line_of_a_step_replaces_the_earlier_one(run_writer, tmp_path):
    run = run_writer(tmp_path / "run", seeds=(0,))
    lines = [{"step": 1, "critic/mean": 5.0}, {"step": 2, "critic/mean": 6.0}, {"step": 1, "critic/mean": 7.0}]
    (run / "seed-0" / "metrics.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
    series = read_run(run).seeds[0].series["critic/mean"]
    assert series.steps.tolist() == [1, 2]
    assert series.values.tolist() == [7.0, 6.0]


def test_headline_is_the_highest_mean_whatever_the_names(runs, run_writer, tmp_path):
    odaf, cloned = (score(read_run(run), run.name) for run in runs)
    better = dataclasses.replace(cloned, mean=1000.0)
    never = score(read_run(run_writer(tmp_path / "never", "odaf", seeds=())), "odaf")
    assert headline_index([cloned, odaf]) == 1
    assert headline_index([odaf, better, never]) == 1
    assert headline_index([never, never]) == 0


def changed(run, name, value, file="config.json"):
    """The run with one setting of its learner, or of another file, changed."""
    content = json.loads((run / file).read_text())
    place, *path = name.split(".")
    inner = content
    for part in [place, *path][:-1]:
        inner = inner[int(part) if isinstance(inner, list) else part]
    inner[[place, *path][-1]] = value
    (run / file).write_text(json.dumps(content))
    return run


def test_runs_are_named_by_what_differs_between_them(run_writer, tmp_path):
    four, ten, weight, cloned = (
        run_writer(tmp_path / name, preset, seeds=(), critic=preset == "odaf")
        for name, preset in (("a", "odaf"), ("b", "odaf"), ("c", "odaf"), ("d", "behaviour-cloning"))
    )
    changed(four, "algorithm.num_critics", 4)

    def named(*runs):
        return names_of([read_run(run) for run in runs])

    assert named(four, cloned) == ["odaf", "behaviour-cloning"]
    assert named(four, ten, cloned) == ["odaf, num_critics 4", "odaf, num_critics 10", "behaviour-cloning"]
    assert named(ten, weight) == ["odaf (b)", "odaf (c)"], "nothing differs"
    changed(weight, "algorithm.terms.0.weight", 0.1)
    assert named(ten, weight) == ["odaf, outcome.weight 0.3", "odaf, outcome.weight 0.1"]
    assert named(four, ten, weight)[2] == "odaf, num_critics 10, outcome.weight 0.1"
    changed(weight, "algorithm.terms.0.weight", 0.3)
    changed(weight, "steps", 5)
    assert named(ten, weight) == ["odaf, steps 20000", "odaf, steps 5"]
    changed(weight, "path", "other.h5", "data.json")
    changed(weight, "steps", 20000)
    assert named(ten, weight) == ["odaf (b)", "odaf (c)"], "the same log under another name"
    changed(weight, "sha256", "cd34", "data.json")
    assert named(ten, weight) == ["odaf, data stitch.h5", "odaf, data other.h5"]
    changed(weight, "path", "/logs/new/stitch.h5", "data.json")
    changed(ten, "path", "/logs/old/stitch.h5", "data.json")
    assert named(ten, weight) == ["odaf, data old/stitch.h5", "odaf, data new/stitch.h5"], "files of one name"


def test_of_many_settings_those_name_a_run_that_tell_it_apart(run_writer, tmp_path):
    """Four settings differ; the first that differs parts both runs, and the rest is in the page's table."""
    runs = [run_writer(tmp_path / name, "odaf", seeds=()) for name in "ab"]
    for name, value in (("num_critics", 4), ("discount", 0.9), ("critic_norm", "none"), ("hidden_sizes", [8, 8])):
        changed(runs[1], f"algorithm.{name}", value)
    assert names_of([read_run(run) for run in runs]) == ["odaf, num_critics 10", "odaf, num_critics 4"]
    changed(runs[1], "algorithm.discount", 0.99)
    first, second = names_of([read_run(run) for run in runs])
    assert first == "odaf, num_critics 10, critic_norm layer, without hidden_sizes"
    assert second == "odaf, num_critics 4, critic_norm none, hidden_sizes 8 8"
    assert names_of([read_run(runs[0])] * 2) == [f"odaf ({runs[0]})"] * 2


LONG = [f"odaf-locomotion-without-outcome, num_critics {n}, outcome.dynamics.hidden_sizes 256 256" for n in range(8)]
NEAR = [("best logged", 72.63), ("logged mean", 72.5), ("best logged", 72.8), ("logged mean", 140.0)]


def collisions(figure):
    """Pairs of words of a picture that lie on each other, and words that leave it."""
    figure.draw_without_rendering()
    axis = [axis for axes in figure.axes for axis in (axes.xaxis, axes.yaxis)]
    off = {
        word
        for axes in figure.axes
        if not axes.axison
        for one in (axes.xaxis, axes.yaxis)
        for word in one.findobj(Text)
    }
    # An axis keeps marks beyond its ends, which are not drawn.
    beyond = [(mark.label1, mark.get_loc(), one.get_view_interval()) for one in axis for mark in one.majorTicks]
    hidden = {label for label, place, ends in beyond if not min(ends) <= place <= max(ends)}
    words = [word for word in figure.findobj(Text) if word.get_visible() and word.get_text().strip()]
    words = [word for word in words if word not in hidden | off]
    boxes = [(word.get_text(), Text.get_window_extent(word)) for word in words]
    # A hair's breadth is no collision.
    inner = [(text, box.padded(-0.5)) for text, box in boxes]
    found = [(one, other) for i, (one, a) in enumerate(inner) for other, b in inner[:i] if a.overlaps(b)]
    whole = figure.bbox.padded(1.0)
    return found + [(text, "the edge") for text, box in boxes if not (box.x0 >= whole.x0 and box.x1 <= whole.x1)]


def test_names_never_lie_on_each_other_on_the_page(runs, monkeypatch):
    """Eight runs with long names, and lines of the log that lie close together."""
    drawn = []
    monkeypatch.setattr(chart, "to_svg", lambda figure, name, title: drawn.append((name, figure)) or Markup(""))
    monkeypatch.setattr(charts, "references", lambda _: NEAR)
    records = [read_run(runs[0])] * 8
    scores = [score(records[0], name) for name in LONG]
    charts.returns_chart(records, scores)
    charts.curves_chart(records, LONG)
    long_names = dict(records[0].data) | {
        "summary": dict(records[0].summary_of_data)
        | {"observation_names": [f"{name} of the plant" for name in LONG[:4]]}
    }
    charts.dynamics_checks([dataclasses.replace(records[0], data=long_names)], LONG[:1])
    assert [name for name, _ in drawn] == ["returns", "curves", "dynamics-0"]
    for name, figure in drawn:
        assert collisions(figure) == [], name
        assert figure.axes[0].get_position().width * figure.get_size_inches()[0] > 1.5, "room for the drawing"


def test_names_never_lie_on_each_other_in_picture_files(runs, monkeypatch, tmp_path):
    drawn = []
    monkeypatch.setattr(figures, "write_figure", lambda figure, out: drawn.append(figure) or out)
    curves, _ = figures.run_curves([runs[0]])
    curves = [dataclasses.replace(curves[0], label=name, index=index) for index, name in enumerate(LONG)]
    figures.learning_curves_figure(curves, tmp_path / "a.png", NEAR, title="A long title " * 9, note="a note " * 40)
    figures.maze_figure(runs, tmp_path / "b.png", names=LONG[:2], title="A long title " * 12)
    figures.maze_figure(runs[:1], tmp_path / "c.png", names=LONG[:1])
    for figure in drawn:
        assert collisions(figure) == []
        assert all(axes.get_window_extent().height > 100 for axes in figure.axes)


def test_words_are_broken_where_they_end_and_left_out_in_the_middle():
    assert lettering.fitted("one two", 1000, 8) == "one two"
    wide = lettering.width_of("two", 8)
    assert lettering.fitted("one two", wide + 1, 8) == "one\ntwo"
    assert lettering.fitted("long_name", lettering.width_of("name", 8) + 4, 8) == "long_\nname"
    short = lettering.fitted("a rather long name of a run", lettering.width_of("a rather lo", 8), 8, lines=1)
    assert short.startswith("a r") and short.endswith("un") and "…" in short and "\n" not in short


def test_places_are_spread_no_further_than_needed():
    assert lettering.spread_out([30.0, 10.0], 10.0, 0.0, 100.0) == [30.0, 10.0]
    assert lettering.spread_out([20.0, 22.0], 10.0, 0.0, 100.0) == [16.0, 26.0]  # each gives way by 4
    assert lettering.spread_out([1.0, 2.0], 10.0, 0.0, 100.0) == [0.0, 10.0]
    assert lettering.spread_out([98.0, 99.0], 10.0, 0.0, 100.0) == [90.0, 100.0]
    assert lettering.spread_out([], 10.0, 0.0, 100.0) == []


def test_settings_are_compared_name_by_name():
    first = {"steps": 5, "algorithm": {"terms": [{"kind": "outcome", "weight": 0.3}], "sizes": [8, 8]}}
    second = {"steps": 5, "algorithm": {"terms": [{"kind": "ood", "weight": 0.3}], "sizes": [8, 8]}, "seeds": [1]}
    assert flatten(first)["algorithm.sizes"] == "[8, 8]"
    assert dict(differences([first, second])) == {
        "algorithm.terms[outcome].kind": ["outcome", "–"],
        "algorithm.terms[outcome].weight": ["0.3", "–"],
        "algorithm.terms[ood].kind": ["–", "ood"],
        "algorithm.terms[ood].weight": ["–", "0.3"],
        "seeds": ["–", "[1]"],
    }
    assert differences([first, first]) == []


def test_maze_letters_stand_where_the_task_says():
    layout = maze_layout(MAZE)
    assert layout is not None
    expected = {"S": (-0.5, 0.5), "M": (-0.5, -0.5), "G": (1.5, -0.5), "A": (-1.5, 0.5), "B": (-1.5, -0.5)}
    assert dict(layout.names) == expected
    assert len(layout.walls) == 24 - 6
    assert maze_layout({"name": "gymnasium", "id": "Hopper-v5"}) is None
    with pytest.raises(ConfigError, match="border"):
        maze_layout({"name": "pointmaze", "maze": MAZE["maze"] | {"rows": ["000000", "100111", "100001", "111111"]}})


def test_an_ant_maze_stands_as_its_map_does_with_y_downwards():
    layout = maze_layout({"name": "gymnasium", "id": "odaf/AntMaze-UMaze-v0", "kwargs": {}})
    assert layout is not None and (layout.name, layout.aspect, len(layout.walls)) == ("umaze", 1.0, 25 - 7)
    assert dict(layout.names) == {"S": (0.0, 0.0), "G": (0.0, 8.0)} and layout.goal == (0.75, 8.75)
    axes = Figure().add_subplot()
    drawing.draw_maze(axes, drawing.LIGHT, layout, None, None)
    assert axes.yaxis_inverted() and not axes.xaxis_inverted()
    (letter,) = (text for text in axes.texts if text.get_text() == "G")
    assert letter.get_position() == pytest.approx((-1.76, 8.0 - 1.72)), "in the upper left corner of its cell"
    assert max(patch.get_width() for patch in axes.patches if isinstance(patch, Rectangle)) == 4.0
    own = {"name": "gymnasium", "id": "odaf/AntMaze-v0", "kwargs": {"maze": ["11111", "1rgg1", "11111"]}}
    several = maze_layout(own)
    assert several is not None and several.goal is None and set(several.names) == {"S", "G1", "G2"}
    drawing.draw_maze(Figure().add_subplot(), drawing.LIGHT, several, None, None)
    assert maze_layout({"name": "gymnasium", "id": "odaf/AntMaze-v0"}) is None


def test_where_nothing_says_who_stitches_success_is_what_counts(run_writer, tmp_path):
    directory = run_writer(tmp_path / "ant", seeds=(0,), stitches=0.4)
    content = json.loads((directory / "data.json").read_text())
    content["environment"] = {"name": "gymnasium", "id": "odaf/AntMaze-UMaze-v0", "kwargs": {}}
    (directory / "data.json").write_text(json.dumps(content))
    for file in (directory / "seed-0" / "evaluations").glob("*.npz"):
        with np.load(file) as arrays:
            kept = {name: arrays[name] for name in arrays.files if name != "stitched"}
        np.savez(file, **kept)
    run = read_run(directory)
    learned = paths.learned_paths(run)
    assert learned is not None and learned.good is not None
    assert (learned.doing, int(learned.good.sum()), paths.good_key([run])) == ("reach the goal", 20, "reaches the goal")
    (chart,) = paths.maze_charts([run], ["ant"])
    assert chart.caption == "20 of 50 reach the goal. Each has a goal of its own within the ring."


def test_a_log_of_a_maze_is_drawn_in_it():
    ant = {"name": "gymnasium", "id": "odaf/AntMaze-UMaze-v0", "kwargs": {}}
    drawn = pictures.maze_chart(dataset_of(29, 8, ant))
    assert drawn is not None and "Logged paths in the maze umaze" in drawn.svg and ">G</text>" in drawn.svg
    assert drawn.caption.startswith("All episodes, in the plane")
    assert pictures.maze_chart(dataset_of(4, 2, {"name": "gymnasium", "id": "Hopper-v5"})) is None


def test_drawn_paths_are_the_recorded_ones():
    layout = maze_layout(MAZE)
    assert layout is not None
    rng = np.random.default_rng(0)
    positions = rng.normal(size=(20, 30, 2))
    positions[3, 10:] = np.nan  # an episode that ended early
    stitched = np.arange(20) % 4 == 3
    axes = Figure().add_subplot()
    drawing.draw_maze(axes, drawing.LIGHT, layout, Trajectories(positions, stitched), Trajectories(positions[:5]))
    for colour, chosen in ((drawing.LIGHT.stitched, stitched), (drawing.LIGHT.detour, ~stitched)):
        lines = [line for line in axes.lines if line.get_color() == colour]
        paths = np.concatenate([np.column_stack(line.get_data()) for line in lines if line.get_linestyle() != "None"])
        drawn = paths[np.isfinite(paths).all(axis=1)]
        wanted = positions[chosen].reshape(-1, 2)
        wanted = wanted[np.isfinite(wanted).all(axis=1)]
        np.testing.assert_array_equal(np.sort(drawn, axis=0), np.sort(wanted, axis=0))
        (ends,) = [np.column_stack(line.get_data()) for line in lines if line.get_linestyle() == "None"]
        last = positions[:, -1].copy()
        last[3] = positions[3, 9]
        np.testing.assert_array_equal(ends, last[chosen])
    grey = [line for line in axes.lines if line.get_color() == drawing.LIGHT.data]
    points = np.concatenate([np.column_stack(line.get_data()) for line in grey])
    assert np.isfinite(points).all(axis=1).sum() == np.isfinite(positions[:5]).all(axis=2).sum()


def test_joined_paths_never_connect_two_episodes():
    paths = np.arange(24.0).reshape(4, 3, 2)
    lines = drawing._joined(paths, groups=3)
    assert len(lines) == 3
    np.testing.assert_array_equal(lines[0][:3], paths[0])
    assert np.isnan(lines[0][3]).all()
    np.testing.assert_array_equal(lines[0][4:7], paths[3])


def test_curve_band_is_the_interval_over_seeds_or_the_spread_over_episodes():
    steps = np.array([1, 2, 3])
    nan = np.nan
    curve = Curve("m", steps, np.array([[1.0, 2.0, nan], [3.0, nan, nan]]), None, 0)
    mean, low, high = drawing.band(curve)
    np.testing.assert_array_equal(mean, [2.0, 2.0, nan])
    # Two values: 12.7062 standard errors, each half of their distance.
    np.testing.assert_allclose(low, [2.0 - 12.7062, 2.0, nan], rtol=1e-5)
    np.testing.assert_allclose(high, [2.0 + 12.7062, 2.0, nan], rtol=1e-5)
    np.testing.assert_array_equal(drawing.extremes(curve), [[1.0, 2.0, nan], [3.0, 2.0, nan]])
    mean, low, high = drawing.band(Curve("m", steps, np.array([[1.0, 2.0, 3.0]]), np.array([0.5, 0.5, 1.0]), 0))
    np.testing.assert_array_equal(low, [0.5, 1.5, 2.0])
    np.testing.assert_array_equal(high, [1.5, 2.5, 4.0])


def test_curves_of_seeds_with_different_steps_share_one_axis(runs):
    curves = charts.return_curves([read_run(run) for run in runs], ["odaf", "cloned"])
    assert [curve.values.shape for curve in curves] == [(2, 4), (1, 4)]
    assert curves[0].steps.tolist() == [5000, 10000, 15000, 20000]
    assert curves[0].spread is None and curves[1].spread is not None
    assert [curve.index for curve in curves] == [0, 1]


def test_critic_is_judged_against_what_the_rewards_allow(runs):
    run = read_run(runs[0])
    assert charts.allowed_range(run) == pytest.approx((0.0, 99.8))
    low = Curve("m", np.array([1]), np.array([[-0.5]]), None, 0)
    high = Curve("m", np.array([1]), np.array([[50.0]]), None, 0)
    assert charts._stays_inside(low, high, (-1.0, 99.8)) == "Outputs from -0.5 to 50.0: inside what the rewards allow."
    assert charts._stays_inside(low, high, (0.0, 45.0)).endswith("up to 5.00 outside what the rewards allow.")


@pytest.mark.parametrize(
    ("value", "short"),
    [(0, "0"), (999, "999"), (1500, "1.5k"), (20000, "20k"), (3e6, "3M"), (-2000, "-2k"), (0.3, "0.3")],
)
def test_counts_are_written_short(value, short):
    assert drawing.short_count(value) == short


@pytest.mark.parametrize(
    ("value", "text"),
    [(1234.5, "1,234"), (121.34, "121.3"), (7.256, "7.26"), (0.01234, "0.0123"), (np.nan, "–"), (0.0, "0.0")],
)
def test_numbers_keep_the_digits_that_mean_something(value, text):
    assert drawing.plain_number(value) == text


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (["/venv/bin/odaf", "train", "odaf", "--data", "a b.h5"], "odaf train odaf --data 'a b.h5'"),
        (["/lib/odaf/__main__.py", "demo"], "python -m odaf demo"),
        (["study.py", "--fast"], "python study.py --fast"),
        (None, None),
    ],
)
def test_command_is_ready_to_paste(runs, words, line):
    run = read_run(runs[0])
    object.__setattr__(run, "machine", {"command": words})
    assert page.command(run) == line


def test_maze_picture_holds_both_methods_and_the_log(runs, tmp_path):
    out = figures.maze_figure(runs, tmp_path / "pictures" / "maze.png", names=["ODAF", "$cloning"], title="Two")
    pixels = np.round(imread(out)[..., :3] * 255).astype(int)
    left, right = np.array_split(pixels, 2, axis=1)

    def amount(part, colour):
        red, green, blue = (int(colour[place : place + 2], 16) for place in (1, 3, 5))
        return int((np.abs(part - [red, green, blue]).max(axis=2) < 40).sum())

    assert amount(left, drawing.LIGHT.stitched) > 2 * amount(right, drawing.LIGHT.stitched)
    assert amount(right, drawing.LIGHT.detour) > 2 * amount(left, drawing.LIGHT.detour)
    assert amount(pixels, drawing.LIGHT.wall) > 10000


def test_maze_picture_refuses_runs_without_paths(run_writer, tmp_path):
    run = run_writer(tmp_path / "run", seeds=(0,), data={"environment": False})
    with pytest.raises(ConfigError, match=r"run: no paths to draw, its data name no maze"):
        figures.maze_figure([run], tmp_path / "maze.png")
    never = run_writer(tmp_path / "never", seeds=(0,), evaluated=False)
    with pytest.raises(ConfigError, match=r"never: no paths to draw, it kept no evaluation episodes"):
        figures.maze_figure([never], tmp_path / "maze.png")
    with pytest.raises(ConfigError, match="2 names for 1 runs"):
        figures.maze_figure([run], tmp_path / "maze.png", names=["one", "two"])


def test_curves_picture_is_drawn_from_runs_or_from_numbers(runs, tmp_path):
    curves, references = figures.run_curves(runs)
    assert [name for name, _ in references] == ["best logged", "logged mean"]
    assert references[0][1] == pytest.approx(72.63)
    out = figures.learning_curves_figure(curves, tmp_path / "curves.png", references, note="locally generated data")
    assert imread(out).shape[1] == round(6.4 * figures.RESOLUTION)
    with pytest.raises(ConfigError, match="no curves"):
        figures.learning_curves_figure([], tmp_path / "none.png")
