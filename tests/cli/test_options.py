"""Options made from dataclasses: names, help, defaults, terms as groups, and the way back."""

import dataclasses
from typing import Any, ClassVar, Literal

import pytest

from odaf.cli.options import field_help, parse, settings_of, with_settings
from odaf.runs import presets


@dataclasses.dataclass(frozen=True)
class Model:
    """A model."""

    kind: Literal["cvae", "ensemble"] = "cvae"
    """Which model."""
    hidden_sizes: tuple[int, ...] = (256, 256)
    """Widths."""


@dataclasses.dataclass(frozen=True)
class Penalty:
    """A term."""

    name: ClassVar[str] = "outcome"

    weight: float = 0.3
    """How much
    it counts."""
    dynamics: Model = Model()
    """The model."""


@dataclasses.dataclass(frozen=True)
class Base:
    discount: float = 0.99
    """gamma."""


@dataclasses.dataclass(frozen=True)
class Learner(Base):
    num_critics: int = 10
    """K."""
    critic_norm: Literal["layer", "none"] = "layer"
    undocumented: int | None = None
    entropy: bool = False
    """Whether."""
    terms: tuple[Any, ...] = ()
    """Additions."""


LEARNER = Learner(num_critics=4, terms=(Penalty(weight=1.0),))


def read(learner: Any, *words: str) -> Any:
    kind = dataclasses.make_dataclass("Options", settings_of(learner), frozen=True)
    return with_settings(learner, parse(kind, list(words), "probe"))


def test_without_options_the_learner_comes_back_equal():
    assert read(LEARNER) == LEARNER


@pytest.mark.parametrize("name", presets.names())
def test_every_preset_survives_the_way_through_its_options(name: str):
    algorithm = presets.load(name)
    assert read(algorithm) == algorithm


def test_options_change_what_they_name_and_nothing_else():
    found = read(
        LEARNER, "--num-critics", "2", "--critic-norm", "none", "--undocumented", "7", "--entropy",
        "--outcome.weight", "0", "--outcome.dynamics.kind", "ensemble", "--outcome.dynamics.hidden-sizes", "8",
    )  # fmt: skip
    assert found == Learner(
        num_critics=2, critic_norm="none", undocumented=7, entropy=True, terms=(Penalty(0.0, Model("ensemble", (8,))),)
    )


def test_underscores_are_as_good_as_hyphens():
    assert read(LEARNER, "--num_critics", "3").num_critics == 3


def test_help_comes_from_the_strings_under_the_fields():
    assert field_help(Learner) == {
        "discount": "gamma.",
        "num_critics": "K.",
        "entropy": "Whether.",
        "terms": "Additions.",
    }
    assert field_help(Penalty)["weight"] == "How much it counts."


def test_the_help_page_shows_type_default_and_line_of_every_field(capsys: pytest.CaptureFixture[str]):
    with pytest.raises(SystemExit) as stop:
        read(LEARNER, "--help")
    assert stop.value.code == 0
    page = " ".join(capsys.readouterr().out.split())
    assert "--num-critics INT" in page
    assert "K. (default: 4)" in page
    assert "--outcome.weight FLOAT" in page
    assert "How much it counts. (default: 1.0)" in page
    assert "--outcome.dynamics.kind {cvae,ensemble}" in page
    assert "--terms" not in page


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (["--num-critics", "many"], "--num-critics"),
        (["--critic-norm", "batch"], "--critic-norm"),
        (["--outcome.weigh", "1"], "--outcome.weigh"),
    ],
)
def test_wrong_options_end_with_code_2_and_name_themselves(
    words: list[str], named: str, capsys: pytest.CaptureFixture[str]
):
    with pytest.raises(SystemExit) as stop:
        read(LEARNER, *words)
    assert stop.value.code == 2
    assert named in capsys.readouterr().err
