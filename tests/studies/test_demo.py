"""The demo end to end, small: what it writes, what its summary says, and that a second call trains nothing again."""

import json
from pathlib import Path

import pytest

from odaf.environments import stitch_data
from odaf.studies import demo


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    """Few episodes, and the method that compiles soonest."""
    whole = stitch_data.generate
    few = stitch_data.CONFIGS["stitch"].with_repeats(2)
    monkeypatch.setattr(stitch_data, "generate", lambda seed: whole(few, seed))
    monkeypatch.setattr(demo, "METHODS", {"behaviour-cloning": "cloning"})
    monkeypatch.setattr(demo, "EPISODES", 3)


@pytest.mark.usefixtures("small")
def test_demo_writes_what_it_promises_and_goes_on_where_it_stopped(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    summary = demo.run(tmp_path, steps=8)
    assert json.loads((tmp_path / "summary.json").read_text(encoding="utf-8")) == summary

    log = stitch_data.generate(seed=demo.DATA_SEED)
    assert summary["dataset"]["mean_return"] == pytest.approx(log.episode_returns().mean())
    assert summary["dataset"]["best_return"] == pytest.approx(log.episode_returns().max())
    method = summary["methods"]["behaviour-cloning"]
    assert set(method) == {"mean_return", "std_return", "success_rate", "stitched_rate", "updates_per_second"}
    episodes = sorted((tmp_path / "behaviour-cloning" / "seed-0" / "evaluations").iterdir())[-1]
    assert episodes.stem == "00000008"
    assert (tmp_path / "report.html").stat().st_size > 10_000
    assert (tmp_path / "maze.png").read_bytes().startswith(b"\x89PNG")
    printed = capsys.readouterr().out
    assert "locally generated data" in printed
    assert f"{method['mean_return']:.1f}" in printed

    before = episodes.stat().st_mtime_ns
    again = demo.run(tmp_path, steps=8)
    assert again["methods"] == summary["methods"]
    assert episodes.stat().st_mtime_ns == before
