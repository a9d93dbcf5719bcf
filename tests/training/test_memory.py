"""Programs are forgotten before their memory maps fill the process, and trainings go on as before."""

import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import pytest

from odaf.training import memory


def _maps() -> int:
    return Path("/proc/self/maps").read_bytes().count(b"\n")


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="Linux counts memory maps")
def test_programs_are_forgotten_once_they_hold_half_of_the_maps(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    programs = [jax.jit(lambda x, factor=factor: jnp.sin(x) * factor) for factor in range(30)]
    for number, program in enumerate(programs):
        assert float(program(0.5)) == pytest.approx(0.479426 * number, rel=1e-5)
    before, most = _maps(), tmp_path / "most"
    monkeypatch.setattr(memory, "_MOST_MAPS", most)
    most.write_text(str(3 * before))
    memory.forget_programs_in_time()
    assert _maps() > before - 20, "a third is not half"
    most.write_text(str(before))
    memory.forget_programs_in_time()
    assert _maps() < before - 50
    assert float(programs[2](0.5)) == pytest.approx(0.958851, rel=1e-5)


def test_where_no_maps_are_counted_nothing_is_forgotten(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    monkeypatch.setattr(memory, "_MAPS", tmp_path / "none")
    monkeypatch.setattr(jax, "clear_caches", lambda: pytest.fail("forgotten"))
    memory.forget_programs_in_time()
