"""Jobs that a fresh process can import, for the tests of worker processes."""

import os
import time

from odaf.runs.workers import send

prepared: list[int] = []


def prepare(number: int) -> None:
    prepared.append(number)


def preparations(_: int) -> list[int]:
    return list(prepared)


def halve(number: int) -> int:
    for part in ("half of", number):
        send((number, part))
    return number // 2


def sleep(seconds: float) -> float:
    time.sleep(seconds)
    return seconds


def process(_: int) -> int:
    return os.getpid()
