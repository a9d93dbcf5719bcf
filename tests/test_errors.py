"""Messages that offer only what can be done where the user is."""

import pickle

import pytest

from odaf.errors import OPTION, DatasetError

REMEDIES = ["pass sort_by=['id', 'time']", "name another column with episode=", "remove the rows"]


def test_all_remedies_are_shown_where_nothing_says_which_options_there_are():
    error = DatasetError("log.csv: rows are out of order", remedies=REMEDIES)
    assert str(error) == f"log.csv: rows are out of order; {REMEDIES[0]}, or {REMEDIES[1]}, or {REMEDIES[2]}"


def test_a_remedy_whose_option_does_not_exist_is_left_out():
    error = DatasetError("log: rows are out of order", remedies=REMEDIES)
    error.offer(["episode", "reward"])
    assert error.takeable() == tuple(REMEDIES[1:])
    error.offer(["reward"])
    assert str(error) == "log: rows are out of order; remove the rows"


def test_a_message_without_remedies_is_what_was_given():
    assert str(DatasetError("all is said")) == "all is said"


def test_an_error_crosses_to_another_process():
    error = DatasetError("log: odd", remedies=REMEDIES)
    error.offer(["episode"])
    assert str(pickle.loads(pickle.dumps(error))) == str(error)


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("pass reward=, or reward=0.0", ["reward", "reward"]),
        ("where steps == 3 or steps==3", []),
        ("from_arrays(..., episode=ids)", ["episode"]),
        ("/tmp/a=b/run=3/log.h5, seed-rate=4, 'c=d'", []),
    ],
)
def test_options_are_told_from_other_signs_of_equality(text: str, found: list[str]):
    assert OPTION.findall(text) == found
