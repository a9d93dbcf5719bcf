"""JSON lines: what is written, what a kill may leave, what is cut."""

import json

import pytest

from odaf.errors import CheckpointError
from odaf.training import logging


def _write(path, *lines):
    path.write_bytes(b"".join(lines))


def test_records_come_back_in_order_and_infinities_as_none(tmp_path):
    lines = logging.JsonLines()
    lines.open(tmp_path, 0)
    lines.log(1, {"a/b": 0.5, "a/c": float("nan")})
    lines.log(2, {"a/b": float("inf"), "n": 3})
    assert logging.read(tmp_path / "metrics.jsonl") == [  # readable while the run goes on
        {"step": 1, "a/b": 0.5, "a/c": None},
        {"step": 2, "a/b": None, "n": 3},
    ]
    lines.close()
    assert all(json.loads(line) for line in (tmp_path / "metrics.jsonl").read_text().splitlines())


@pytest.mark.parametrize("torn", [b'{"step": 3, "a', b'{"step": 3}', b"\xff\xfe", b"3"])
def test_torn_last_line_is_left_out_and_cut_on_opening(tmp_path, torn):
    path = tmp_path / "metrics.jsonl"
    _write(path, b'{"step": 1}\n', b'{"step": 2}\n', torn)
    assert [record["step"] for record in logging.read(path)] == [1, 2]
    lines = logging.JsonLines()
    lines.open(tmp_path, 2)
    lines.log(3, {})
    lines.close()
    assert path.read_bytes() == b'{"step": 1}\n{"step": 2}\n{"step": 3}\n'


def test_records_after_the_checkpoint_are_cut_and_those_of_its_own_step_stay(tmp_path):
    path = tmp_path / "metrics.jsonl"
    _write(path, b'{"step": 5}\n', b'{"step": 5, "evaluation/return_mean": 1}\n', b'{"step": 6}\n')
    logging.truncate(path, 5)
    assert [record["step"] for record in logging.read(path)] == [5, 5]
    logging.truncate(path, 0)
    assert path.read_bytes() == b""
    logging.truncate(tmp_path / "absent.jsonl", 0)
    assert logging.read(tmp_path / "absent.jsonl") == []


def test_damage_in_the_middle_names_its_line_and_changes_nothing(tmp_path):
    path = tmp_path / "metrics.jsonl"
    content = b'{"step": 1}\n{"st\n{"step": 3}\n'
    _write(path, content)
    for call in (logging.read, lambda path: logging.truncate(path, 1)):
        with pytest.raises(CheckpointError, match=r"metrics\.jsonl, line 2: .*Remove that line"):
            call(path)
    assert path.read_bytes() == content
