"""Fits side by side: what they return, what is heard of them, and what happens where one fails."""

import threading

import pytest

from odaf.components import threads
from odaf.components.threads import in_threads, parts_of


@pytest.mark.parametrize(("cores", "members", "parts"), [(1, 16, 1), (2, 16, 2), (2, 3, 1), (4, 6, 3), (16, 8, 8)])
def test_members_are_shared_out_over_the_cores_in_parts_of_one_size(cores, members, parts, monkeypatch):
    monkeypatch.setattr(threads, "usable_cores", lambda: cores)
    assert parts_of(members) == parts


def test_each_has_its_result_and_what_is_heard_is_what_all_have_done():
    heard, second_may_go_on = [], threading.Event()

    def first(told):
        told(5, 10)
        told(10, 10)
        second_may_go_on.set()
        return "first"

    def second(told):
        second_may_go_on.wait()
        told(5, 10)
        told(10, 10)
        return "second"

    assert in_threads([first, second], lambda done, steps: heard.append((done, steps))) == ["first", "second"]
    assert heard == [(5, 10), (10, 10)]
    assert in_threads([lambda told: threading.current_thread()], print) == [threading.current_thread()]


@pytest.mark.parametrize("where", ["fit", "progress"])
def test_where_one_fails_the_others_stop_after_their_stretch(where):
    stretches, has_failed = [], threading.Event()

    def failing(told):
        told(1, 10_000)
        if where == "fit":
            raise ValueError("diverged")
        has_failed.wait()

    def endless(told):
        for stretch in range(1, 10_000):
            stretches.append(stretch)
            told(stretch, 10_000)
            has_failed.wait(0.01)

    def progress(done, steps):
        if where == "progress":
            has_failed.set()
            raise ValueError("diverged")

    with pytest.raises(ValueError, match="diverged"):
        in_threads([failing, endless], progress)
    assert len(stretches) < 9_999
