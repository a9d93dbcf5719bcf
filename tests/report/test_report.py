"""The report page as a reader gets it: what it says, that it stands alone, and what it does when parts are missing."""

import json
import re
import shutil
from html.parser import HTMLParser

import numpy as np
import pytest

from odaf import report
from odaf.errors import CheckpointError, ConfigError
from odaf.report import extras, page
from odaf.report.records import read_run
from odaf.report.scores import score


class Page(HTMLParser):
    """The page's text, tables and attributes, as the standard library's parser sees them."""

    def __init__(self, source):
        super().__init__()
        self.source = source
        self.tags: list[str] = []
        self.attributes: list[tuple[str, str, str]] = []
        self.words: list[str] = []
        self.rows: list[list[str]] = []
        self.open: list[str] = []
        self.feed(source)
        self.text = " ".join(" ".join(self.words).split())

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.attributes += [(tag, name, value or "") for name, value in attrs]
        if tag not in ("meta", "br", "line", "path", "use", "rect"):
            self.open.append(tag)
        if tag == "tr":
            self.rows.append([])
        if tag in ("td", "th"):
            self.rows[-1].append("")

    def handle_endtag(self, tag):
        if tag in self.open:
            while self.open.pop() != tag:
                pass

    def handle_data(self, data):
        if "style" in self.open:
            return
        self.words.append(data)
        if self.rows and {"td", "th"} & set(self.open):
            self.rows[-1][-1] += data

    def row(self, start):
        """The first table row whose first cell begins so, blanks tidied."""
        rows = [[" ".join(cell.split()) for cell in row] for row in self.rows]
        return next(row for row in rows if row and row[0].startswith(start))


def build(runs, out, title=None):
    return Page(report.build(runs, out, title).read_text(encoding="utf-8"))


def evaluation(run, seed):
    return json.loads((run / f"seed-{seed}" / "summary.json").read_text())["evaluation"]


@pytest.fixture(scope="module")
def comparison(tmp_path_factory, run_writer):
    """Two methods, two seeds each, and the page about them."""
    folder = tmp_path_factory.mktemp("runs")
    warning = {"kind": "above-range", "step": 7000, "message": "update 7,000: critic/max is 140.2; what helps: <layer>"}
    runs = [
        run_writer(folder / "cloned", "behaviour-cloning", 41.0, 0.1, critic=False),
        run_writer(folder / "first", "odaf", 121.0, 1.0, warnings=[warning]),
    ]
    return runs, build(runs, folder / "pages" / "report.html")


@pytest.fixture
def runs_of_means(run_writer, tmp_path):
    """Records of runs whose seeds have the given means."""

    def write(*means):
        for run, levels in enumerate(means):
            directory = run_writer(tmp_path / f"run-{run}", seeds=tuple(range(len(levels))), evaluated=False)
            for seed, level in enumerate(levels):
                path = directory / f"seed-{seed}" / "summary.json"
                evaluation = {"step": 20000, "mean_return": level, "std_return": 1.0, "episodes": 5}
                path.write_text(json.dumps(json.loads(path.read_text()) | {"evaluation": evaluation}))
        return [read_run(tmp_path / f"run-{run}") for run in range(len(means))]

    return write


def test_page_needs_nothing_but_itself(comparison):
    _, page = comparison
    assert not re.findall(r"https?:|//[a-z]", page.source), "an address of something outside"
    assert not {"script", "link", "img", "iframe", "object"} & set(page.tags)
    references = [value for _, name, value in page.attributes if name in ("src", "href", "xlink:href", "data")]
    assert references and all(value.startswith("#") for value in references)
    assert "@import" not in page.source
    urls = re.findall(r"url\(([^)]*)\)", page.source)
    assert all(url.startswith("#") for url in urls)


def test_normalised_scores_stand_beside_the_raw_return_with_the_environment_version(tmp_path, run_writer):
    """Hopper's constants, -20.272305 and 3234.3, are written out here again, from the public benchmark."""
    run = run_writer(tmp_path / "hop", level=1500.0)
    data, config = (json.loads((run / name).read_text()) for name in ("data.json", "config.json"))
    data["environment"] = {"name": "gymnasium", "id": "Hopper-v4", "kwargs": {}}
    config["evaluate"]["environment"] = {"name": "gymnasium", "id": "Hopper-v5", "kwargs": {}}
    (run / "data.json").write_text(json.dumps(data))
    (run / "config.json").write_text(json.dumps(config))
    page = build([run], tmp_path / "report.html")

    def score(raw):
        return f"{100 * (raw + 20.272305) / (3234.3 + 20.272305):.1f}"

    means = [evaluation(run, seed)["mean_return"] for seed in (0, 1)]
    row = page.row("odaf hop")
    assert (row[1], row[3]) == (f"{np.mean(means):,.1f}", f"{score(np.mean(means))} Hopper-v5")
    assert page.row("the log, best")[1:4] == ["72.6", "", f"{score(72.63)} Hopper-v4"]  # the log's own version
    seeds = [row for row in page.rows if row[:1] == ["odaf"] and row[1] in ("0", "1")]
    assert [" ".join(row[3].split()) for row in seeds] == [f"{score(mean)} Hopper-v5" for mean in means]
    assert f"normalised score {score(np.mean(means))} in Hopper-v5" in page.text


def test_no_normalised_score_without_reference_returns(comparison):
    _, page = comparison
    assert "normalised" not in page.text.replace("normalised units", "")


def test_references_inside_the_page_have_one_target_each(comparison):
    _, page = comparison
    targets = [value for _, name, value in page.attributes if name == "id"]
    used = {value[1:] for _, name, value in page.attributes if name == "xlink:href"}
    used |= set(re.findall(r"url\(#([^)]*)\)", page.source))
    assert len(targets) == len(set(targets))
    assert used and used <= set(targets)


def test_pictures_take_all_colours_from_the_style_sheet(comparison):
    _, page = comparison
    styles = [value for tag, name, value in page.attributes if name == "style" and tag not in ("span", "div")]
    assert any("var(--stitched)" in style for style in styles)
    assert not [style for style in styles if re.search(r"#[0-9a-f]{3,6}", style)]


def test_table_holds_each_method_with_its_numbers(comparison):
    runs, page = comparison
    for run, method in zip(runs, ("behaviour-cloning", "odaf"), strict=True):
        evaluations = [evaluation(run, seed) for seed in (0, 1)]
        means = np.array([entry["mean_return"] for entry in evaluations])
        row = page.row(f"{method} {run.name}")
        assert row[1] == f"{means.mean():.1f}"
        # Student's t with one degree of freedom is 12.7062 (any printed table); the standard error of two values is
        # half their distance.
        half = 12.7062 * abs(means[0] - means[1]) / 2
        assert row[2] == f"{means.mean() - half:.1f} to {means.mean() + half:.1f}"
        share = 100 if method == "odaf" else 10
        assert row[3:] == [f"{share} %", f"{share} %", "20,000", "61.5", "5 min", "2", "100"]


def test_headline_speaks_of_the_highest_mean_in_the_words_of_the_table(comparison):
    runs, page = comparison
    mean = np.mean([evaluation(runs[1], seed)["mean_return"] for seed in (0, 1)])
    assert f"odaf: mean return {mean:.1f}" in page.text
    assert "best logged return 72.6" in page.text
    interval = page.row("odaf first")[2]
    assert (
        f"odaf has the highest mean return, {mean:.1f} (95 % interval {interval}). That is above the best" in page.text
    )
    assert "Its interval lies above those of all others." in page.text
    assert "199,000 logged transitions 1,000 episodes maze stitch" in page.text


def test_each_seed_has_its_row(comparison):
    runs, page = comparison
    rows = [row for row in page.rows if row and row[-1] == "finished"]
    expected = [f"{evaluation(run, seed)['mean_return']:.1f}" for run in runs for seed in (0, 1)]
    assert [row[2] for row in rows] == expected


def test_generated_data_are_named_once_over_the_scores_and_once_over_their_table(comparison, run_writer, tmp_path):
    _, page = comparison
    assert page.source.count('<span class="tag">locally generated data</span>') == 2
    head, table = page.source.split("Methods compared")
    assert '<span class="tag">' in head.split("<dl")[0]
    assert '<span class="tag">' in table.split("<table")[0]
    others = [
        run_writer(tmp_path / "ours", "odaf", seeds=(0,)),
        run_writer(tmp_path / "theirs", "rorl", seeds=(0,), data={"provenance": {"file": "hopper.h5"}}),
    ]
    assert "locally generated data: odaf" in build(others, tmp_path / "report.html").text


def test_no_method_is_set_apart_by_its_name(comparison):
    """But for the colours and dashes of its curve, every row of the table is written alike."""
    _, page = comparison
    table = page.source.split('<table class="scores">')[1].split("</tbody>")[0]
    rows = re.findall(r"<tr>.*?</tr>", table.split("<tbody>")[1], flags=re.DOTALL)
    bare = [re.sub(r"<svg.*?</svg>|(?<=>)[^<]+", "", row, flags=re.DOTALL) for row in rows]
    assert len(bare) == 2 and bare[0] == bare[1]
    tile = page.source.split('<dl class="tiles">')[1].split(">")[0]
    assert tile.strip() == '<div class="tile"'


def test_what_no_run_has_leaves_neither_columns_nor_sections(run_writer, tmp_path):
    run = run_writer(tmp_path / "run", "rorl", 50.0, seeds=(0,), critic=False, data={"environment": False})
    summary = json.loads((run / "seed-0" / "summary.json").read_text())
    for rate in ("success_rate", "stitched_rate"):
        del summary["evaluation"][rate]
    (run / "seed-0" / "summary.json").write_text(json.dumps(summary))
    page = build([run], tmp_path / "report.html")
    header = next(row for row in page.rows if row[0] == "method")
    assert header[1:] == [
        "mean return",
        "spread over episodes",
        "updates",
        "updates/s",
        "training",
        "seeds",
        "episodes",
    ]
    assert page.row("rorl run")[2] == f"± {summary['evaluation']['std_return']:.1f}"
    assert "One seed has no such interval" in page.text and "Student's t" not in page.text
    headings = re.findall(r"<h2>(.*?)</h2>", page.source)
    assert headings == ["Returns", "Score", "Configuration", "Make it again"]


def test_methods_whose_intervals_overlap_are_not_ranked(run_writer, tmp_path):
    names = ("odaf", "rorl", "edac", "sac-n")
    levels = zip(names, (100.0, 99.0, 20.0, 60.0), ((0, 1, 2), (0, 1, 2), (0, 1, 2), (0,)), strict=True)
    runs = [run_writer(tmp_path / name, name, level, seeds=seeds) for name, level, seeds in levels]
    text = build(runs, tmp_path / "report.html").text
    assert "Its interval overlaps with that of rorl: that does not decide between them." in text
    assert "sac-n has one seed, so nothing is decided there." in text
    alone = build([runs[3], runs[2]], tmp_path / "report.html").text
    assert "sac-n has one seed, so that does not decide which method is better." in alone


def test_headline_compares_numbers_as_they_are_shown(runs_of_means):
    """A mean of 72.631 beside a best of 72.63 is not said to be above it; equal figures share the first place."""
    first, second = runs_of_means([72.631, 72.629], [72.634, 72.632])
    scores = [score(run, name) for run, name in ((first, "first"), (second, "second"))]
    said = page.verdict([first, second], scores, 1, 1)
    assert said.startswith("second, first have the highest mean return, 72.6 each. That is at the best logged episode")
    assert "overlaps with that of first" in said
    assert "second has the highest mean return, 72.633 (95 % interval" in page.verdict([first, second], scores, 1, 3)


def test_names_can_be_chosen(run_writer, tmp_path):
    runs = [run_writer(tmp_path / name, "odaf", seeds=(0,)) for name in ("one", "two")]
    out = tmp_path / "report.html"
    page = Page(report.build(runs, out, names=["<ours>", "theirs"]).read_text())
    assert page.row("<ours> one") and page.row("theirs two")
    for names, said in (
        (["a"], r"1 names for 2 runs \(.*one.*two\)"),
        (["a", "a"], "'a' is given twice"),
        (["a", " "], "empty"),
    ):
        with pytest.raises(ConfigError, match=said):
            report.build(runs, out, names=names)


def test_an_evaluation_without_a_sound_episode_is_named(run_writer, tmp_path):
    run = run_writer(tmp_path / "run", seeds=(0,), evaluated=False)
    summary = json.loads((run / "seed-0" / "summary.json").read_text())
    summary["evaluation"] = {
        "step": 20000,
        "mean_return": None,
        "std_return": None,
        "episodes": 2,
        "returns": [None] * 2,
    }
    (run / "seed-0" / "summary.json").write_text(json.dumps(summary))
    text = build([run], tmp_path / "report.html").text
    assert "seed 0: every episode of its last evaluation broke off on a number that is not finite" in text


def test_mazes_show_stitched_paths_apart_from_others(comparison):
    _, page = comparison
    figures = page.source.split("<h2>Paths</h2>")[1].split("</section>")[0].split("<figure")[1:]
    cloned, odaf = figures
    # 60 of 100 paths are drawn, each a line and an end mark.
    assert odaf.count("stroke: var(--stitched)") >= 60 and "stroke: var(--detour)" not in odaf
    assert "10 of 100 stitch; 60 drawn." in cloned and "stroke: var(--detour)" in cloned
    assert "100 of 100 stitch" in odaf
    assert ("svg", "aria-label", "Paths of odaf in the maze stitch") in page.attributes
    for letter in "SMGAB":
        assert re.search(rf">{letter}</text>", odaf)


def test_health_section_names_warnings(comparison):
    _, page = comparison
    assert "odaf, seed 0. update 7,000: critic/max is 140.2; what helps: <layer>" in page.text
    assert "rewards allow 0.0 to 99.8" in page.text  # 0.998 / (1 - 0.99)


def test_dynamics_model_stands_beside_predicting_no_change(comparison):
    _, page = comparison
    assert ["odaf", "deterministic", "0.0002", "0.0055", "0.0364", "9,950"] in page.rows
    assert ["odaf", "vx", "0.0003", "0.011"] in page.rows


def test_the_spread_of_a_dynamics_model_stands_beside_its_error(run_writer, tmp_path):
    run = run_writer(tmp_path / "run", "odaf", seeds=(0, 1))
    for seed, inside in ((0, 0.9), (1, 0.7)):
        path = run / f"seed-{seed}" / "summary.json"
        summary = json.loads(path.read_text())
        summary["pretrain"]["outcome"] |= {"coverage_50": 0.5 * inside, "coverage_90": inside}
        path.write_text(json.dumps(summary))
    page = build([run], tmp_path / "report.html")
    assert ["odaf", "deterministic", "0.0002", "0.0055", "0.0364", "40 %", "80 %", "9,950"] in page.rows


def test_settings_that_differ_come_first_and_all_are_there(comparison):
    runs, page = comparison
    assert ["algorithm.kind", "behaviour-cloning", "ensemble-sac"] in page.rows
    assert ["algorithm.terms[outcome].radius", "–", "0.01"] in page.rows
    assert not [row for row in page.rows if row and row[0] == "steps"], "both runs have 20,000"
    shown = [json.loads(word) for word in page.words if word.startswith("{")]
    assert [json.loads((run / "config.json").read_text()) for run in runs] == [one for one in shown if "preset" in one]


def test_reader_can_repeat_the_runs(comparison):
    _, page = comparison
    assert "odaf train odaf --data 'my data.h5' --steps 20000" in page.text
    assert "ab12" * 16 in page.text
    assert ["jax", "0.10.2"] in page.rows


def test_same_files_give_the_same_page(comparison, tmp_path):
    runs, page = comparison
    assert build(runs, tmp_path / "again.html").source == page.source


def test_text_from_files_cannot_become_markup(run_writer, tmp_path):
    nasty = "<img src=x onerror=alert(1)> & $\\frac{1}$ \"'"
    run = run_writer(tmp_path / "run", nasty, seeds=(0,), warnings=["<script>alert(2)</script>"])
    data = json.loads((run / "data.json").read_text())
    data["summary"]["observation_names"][0] = "</svg><script>alert(3)</script>"
    data["environment"]["maze"]["name"] = "<b>maze</b>"
    data["path"] = "<script>alert(4)</script>"
    (run / "data.json").write_text(json.dumps(data))
    page = build([run], tmp_path / "report.html", title="</title><script>alert(5)</script>")
    assert not {"img", "script"} & set(page.tags)
    assert f"{nasty}: mean return" in page.text
    for number in (2, 3, 4, 5):
        assert f"<script>alert({number})</script>" in page.text


def without_evaluation(run):
    shutil.rmtree(run / "seed-0" / "evaluations")
    metrics = run / "seed-0" / "metrics.jsonl"
    metrics.write_text("".join(line for line in metrics.read_text().splitlines(True) if "evaluation/" not in line))
    summary = json.loads((run / "seed-0" / "summary.json").read_text())
    (run / "seed-0" / "summary.json").write_text(json.dumps(summary | {"evaluation": None}))


def killed_early(run):
    shutil.rmtree(run / "seed-0")


def killed_before_any_line(run):
    for file in ("metrics.jsonl", "summary.json"):
        (run / "seed-0" / file).unlink()
    shutil.rmtree(run / "seed-0" / "evaluations")


def torn(run):
    (run / "seed-0" / "summary.json").unlink()
    metrics = run / "seed-0" / "metrics.jsonl"
    metrics.write_text(metrics.read_text() + '{"step": 210')


def without_maze(run):
    data = json.loads((run / "data.json").read_text())
    data["environment"] = {"name": "gymnasium", "id": "Hopper-v5", "kwargs": {}}
    data["summary"]["provenance"] = {"file": "hopper.h5"}
    (run / "data.json").write_text(json.dumps(data))


def only_the_configuration(run):
    for path in run.iterdir():
        if path.name != "config.json":
            shutil.rmtree(path) if path.is_dir() else path.unlink()


def not_a_number(run):
    metrics = run / "seed-0" / "metrics.jsonl"
    lines = [json.loads(line) for line in metrics.read_text().splitlines()]
    for line in lines:
        for name in line:
            if name.startswith(("critic", "temperature", "outcome")):
                line[name] = None
    metrics.write_text("".join(json.dumps(line) + "\n" for line in lines))


@pytest.mark.parametrize(
    ("damage", "said"),
    [
        (without_evaluation, ["odaf, seed 0: no evaluation, so it has no score.", "has not been evaluated"]),
        (killed_early, ["odaf: no seed has started", "odaf has not been evaluated"]),
        (
            killed_before_any_line,
            ["odaf, seed 0: unfinished, 0 of 20,000 updates so far.", "no evaluation, so it has no"],
        ),
        (torn, ["odaf, seed 0: unfinished, 20,000 of 20,000 updates so far."]),
        (without_maze, ["1,000 episodes Hopper-v5"]),
        (
            only_the_configuration,
            ["data.json is missing", "environment.json is missing", "does not tell which command"],
        ),
        (not_a_number, ["odaf has a mean return of"]),
    ],
    ids=lambda value: getattr(value, "__name__", None),
)
def test_incomplete_runs_still_give_a_page_that_names_what_is_missing(run_writer, tmp_path, damage, said):
    run = run_writer(tmp_path / "run", seeds=(0,))
    damage(run)
    page = build([run], tmp_path / "report.html")
    for words in said:
        assert words in page.text
    assert ("Health of training" in page.text) == (damage in (without_evaluation, torn, without_maze))
    if damage is without_maze:
        assert "locally generated data" not in page.text


def test_last_evaluation_counts_and_not_the_best(run_writer, tmp_path):
    run = run_writer(tmp_path / "run", seeds=(0,))
    lines = [{"step": 5000, "evaluation/return_mean": 130.0}, {"step": 20000, "evaluation/return_mean": 33.25}]
    (run / "seed-0" / "metrics.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
    summary = json.loads((run / "seed-0" / "summary.json").read_text())
    simulator = {"mujoco": "3.3.7", "contact_margins": "larger"}
    evaluation = {"step": 20000, "mean_return": 33.25, "std_return": 2.0, "episodes": 50, "simulator": simulator}
    summary["evaluation"] = evaluation
    (run / "seed-0" / "summary.json").write_text(json.dumps(summary))
    page = build([run], tmp_path / "report.html")
    played = "odaf run · MuJoCo 3.3.7, the larger contact margin counted"
    assert page.row(played)[1:4] == ["33.2", "± 2.0", "20,000"]
    assert "odaf has a mean return of 33.2 (one seed). That is below the log's mean (40.2)." in page.text


def test_runs_on_different_data_are_called_out(run_writer, tmp_path):
    runs = [run_writer(tmp_path / name, seeds=(0,)) for name in ("one", "two")]
    data = json.loads((runs[1] / "data.json").read_text())
    (runs[1] / "data.json").write_text(json.dumps(data | {"sha256": "other"}))
    page = build([tmp_path], tmp_path / "report.html")  # the folder stands for the runs in it
    assert "trained on different data" in page.text
    for run, file in zip(runs, ("file", "the same file with a note"), strict=True):
        (run / "data.json").write_text(json.dumps(data | {"sha256": file, "rows_sha256": "rows"}))
    assert "trained on different data" not in build([tmp_path], tmp_path / "report.html").text
    assert page.row("odaf, data print ab12ab12 one") and page.row("odaf, data print other two")


def test_what_is_no_run_is_refused_by_name(run_writer, tmp_path):
    out = tmp_path / "report.html"
    with pytest.raises(ConfigError, match="no run directory given"):
        report.build([], out)
    with pytest.raises(ConfigError, match=r"absent: does not exist"):
        report.build([tmp_path / "absent"], out)
    (tmp_path / "empty").mkdir()
    with pytest.raises(ConfigError, match=r"empty: not a run directory, config\.json is missing"):
        report.build([tmp_path / "empty"], out)
    (tmp_path / "file").write_text("")
    with pytest.raises(ConfigError, match=r"file: is a file; expected a run directory"):
        report.build([tmp_path / "file"], out)
    run = run_writer(tmp_path / "run", seeds=(0,))
    with pytest.raises(ConfigError, match="is a folder; name the HTML file"):
        report.build([run], tmp_path)
    config = json.loads((run / "config.json").read_text())
    for field, value in (("format", "other"), ("version", 99)):
        (run / "config.json").write_text(json.dumps(config | {field: value}))
        with pytest.raises(CheckpointError, match=rf"config\.json: field '{field}' is {value!r}"):
            report.build([run], out)
    assert not out.exists()


def test_damaged_files_are_refused_by_name(run_writer, tmp_path):
    run, out = run_writer(tmp_path / "run", seeds=(0,)), tmp_path / "report.html"
    out.write_text("an earlier page")
    whole = {name: (run / name).read_bytes() for name in ("data.json", "data_sample.npz", "seed-0/metrics.jsonl")}

    def refused(name, content, error, match):
        (run / name).write_bytes(content)
        with pytest.raises(error, match=match):
            report.build([run], out)
        (run / name).write_bytes(whole[name])

    refused("data.json", b"{", CheckpointError, r"data\.json: cannot be read as JSON")
    refused(
        "seed-0/metrics.jsonl", b"oops\n" + whole["seed-0/metrics.jsonl"], CheckpointError, r"metrics\.jsonl, line 1"
    )
    refused("data_sample.npz", whole["data_sample.npz"][:200], CheckpointError, r"data_sample\.npz: cannot be read")
    np.savez(tmp_path / "objects.npz", returns=np.array([{}], dtype=object))
    pickled = (tmp_path / "objects.npz").read_bytes()
    refused("data_sample.npz", pickled, CheckpointError, r"data_sample\.npz: cannot be read as plain arrays")
    assert out.read_text() == "an earlier page"


def test_missing_libraries_are_named_with_the_command_that_helps(monkeypatch, tmp_path):
    monkeypatch.setattr(extras, "find_spec", lambda name: None if name == "jinja2" else name)
    with pytest.raises(ConfigError, match=r'jinja2 not installed.*pip install "odaf\[report\]"'):
        report.build([tmp_path], tmp_path / "report.html")
