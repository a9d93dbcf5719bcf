"""The page of refusals says what the code says, and readers' messages name only options that can be given."""

import inspect
import sys
from importlib import import_module
from pathlib import Path

import pytest

from odaf.data.readers import FORMATS
from odaf.errors import OPTION

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from tools import refusals  # noqa: E402

SAMPLE = '''
_LAST = "copy it again"

def load(path, rows):
    """One of each kind."""
    if not path:
        raise DatasetError(f"{path}: there is nothing; {_LAST}") from error
    text = "is odd" if rows else "is empty; fill it"
    if rows > 3:
        raise ConfigError(text)
    counted = ["pass time="] if rows else []
    raise DatasetError(
        f"{path}: column '{rows[0].name}' has {len(rows):,} rows" + " too many",
        remedies=[*counted, f"give {rows}=", "leave them out"],
    )

def other(path):
    return CheckpointError("later")
'''


def test_the_page_is_what_the_code_says():
    page = refusals.PAGE.read_text(encoding="utf-8") if refusals.PAGE.exists() else ""
    lines, wanted = set(page.splitlines()), refusals.page().splitlines()
    missing = [line for line in wanted if line not in lines]
    assert page == refusals.page(), f"run `{refusals.COMMAND}`; not on the page yet: {missing[:3]}"


def test_every_way_of_making_a_message_is_found():
    found = [(each.message, each.remedy) for each in refusals.refusals_in(SAMPLE, "sample")]
    assert found == [
        ("there is nothing", "copy it again"),
        ("is odd", ""),
        ("is empty", "fill it"),
        ("column '<name>' has <number of rows> rows too many", "pass time=, or give <rows>=, or leave them out"),
        ("later", ""),
    ]


@pytest.mark.parametrize("layout", FORMATS.values(), ids=FORMATS)
def test_messages_of_a_reader_name_only_options_that_it_takes(layout):
    """Those that several readers share leave out what one of them lacks when they are raised (`OdafError.offer`)."""
    options = {p.name for p in inspect.signature(import_module(layout.module).read).parameters.values()}
    module = layout.module.removeprefix("odaf.")
    own = [each for each in refusals.all_refusals() if each.module in (module, f"{module}_arrow", f"{module}_fields")]
    assert own
    for each in own:
        named = OPTION.findall(f"{each.message} {each.remedy}")
        assert set(named) <= options | {"format"}, each
