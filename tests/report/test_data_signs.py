"""The page about a data set draws each sign that the log cannot teach what is asked, and no other."""

import numpy as np

from data.checks.test_signs import plant, shifted, with_column
from odaf.data import Dataset
from odaf.report.data_page import page


def headings(columns: dict) -> list[str]:
    arrays = (columns["observations"], columns["actions"], columns["rewards"])
    text = page.render(Dataset.from_arrays(*arrays, episode=columns["episode"], action_bounds=(-1, 1)), "plant")
    _, _, section = text.partition("<h2>What this log may not teach</h2>")
    section = section.partition("<h2>")[0]
    assert section.count("<svg") == section.count("<h3>")
    return [part.partition("<")[0] for part in section.split("<h3>")[1:]]


def test_a_sound_log_has_no_such_section():
    assert headings(plant()) == []


def test_every_sign_has_its_picture():
    columns = plant(delay=2)
    columns = with_column(columns, shifted(columns, 0))
    columns["rewards"] = np.square(columns["observations"][:, 0])
    columns["observations"][columns["episode"] == 7, 0] += 20
    assert headings(columns) == [
        "A column that holds the action",
        "A reward that one column says",
        "Actions that act late",
        "Where only one episode went",
    ]
    assert headings(plant(gain=0.0)) == ["Actions that change nothing"]
    columns = plant(columns=1)
    sign = np.where(columns["episode"] % 3 == 0, -1.0, 1.0)[:, None]
    columns["actions"] = sign * (np.tanh(columns["observations"][:, :1]) + 0.1 * columns["actions"]) / 1.2
    assert headings(columns) == ["Controllers in conflict"]
