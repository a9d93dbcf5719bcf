"""What is shown on a terminal and what in a log."""

import io

from rich.console import Console

from odaf.training import progress


def test_lines_are_rare_but_the_last_is_never_missing(monkeypatch):
    now = [0.0]
    monkeypatch.setattr("time.monotonic", lambda: now[0])
    stream = io.StringIO()
    report = progress.Lines(stream, interval=10.0)
    report.start("seed 0: compiling", 0)
    report.start("seed 0: training", 100, done=20)
    for done in range(21, 101):
        now[0] += 0.5
        report.advance(done, "return 12.5" if done == 40 else "")
    report.message("something happened")
    report.close()
    lines = stream.getvalue().splitlines()
    assert lines[0] == "seed 0: training: 40/100  2 updates/s  0:30 left  return 12.5"  # an earlier process did 20
    assert lines[-2:] == ["seed 0: training: 100/100  2 updates/s  return 12.5", "something happened"]
    assert len(lines) == 5


def test_the_end_is_said_once_and_in_the_stages_own_unit(monkeypatch):
    now = [0.0]
    monkeypatch.setattr("time.monotonic", lambda: now[0])
    stream = io.StringIO()
    report = progress.Lines(stream)
    report.start("hopper-random", 10, unit="rows")
    now[0] = 2.0
    for _ in range(3):
        report.advance(10)
    report.advance(10, "return 3.0")  # news at the end is told
    lines = stream.getvalue().splitlines()
    assert len(lines) == 2 and all("rows/s" in line for line in lines)
    assert lines[1].endswith("return 3.0")


def test_bar_shows_stage_rate_and_note_on_a_terminal(monkeypatch):
    now = [0.0]
    monkeypatch.setattr("time.monotonic", lambda: now[0])
    stream = io.StringIO()
    report = progress.Bar(Console(file=stream, force_terminal=True, width=140))
    report.start("seed 0: compiling", 0)
    report.start("seed 0: training", 1000)
    now[0] = 2.0
    report.advance(500, "return 12.5")
    report.message("values [left] the range")
    report.advance(1000)
    report.close()
    text = stream.getvalue()
    for part in (
        "seed 0: compiling",
        "seed 0: training",
        "1,000/1,000",
        "updates/s",
        "return 12.5",
        "values [left] the",
    ):
        assert part in text


def test_choice_of_report(monkeypatch):
    assert isinstance(progress.default_progress(False), progress.Silent)
    assert isinstance(progress.default_progress(True), progress.Lines)  # tests write to no terminal
    own = progress.Silent()
    assert progress.default_progress(own) is own
    monkeypatch.setenv("FORCE_COLOR", "1")
    assert isinstance(progress.default_progress(True), progress.Bar)


def test_no_speed_is_told_of_what_took_no_time(monkeypatch):
    now = [0.0]
    monkeypatch.setattr("time.monotonic", lambda: now[0])
    stream = io.StringIO()
    report = progress.Lines(stream, interval=0.0)
    report.start("seed 0: training", 100_000)
    now[0] = 1e-4
    report.advance(50_000)
    now[0] = 1.0
    report.advance(100_000)
    lines = stream.getvalue().splitlines()
    assert lines == ["seed 0: training: 50,000/100,000", "seed 0: training: 100,000/100,000  100,000 updates/s"]
