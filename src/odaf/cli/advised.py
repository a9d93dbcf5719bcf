"""`odaf train auto`: the preset that the log asks for."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING

from odaf.cli.bars import rows_bar
from odaf.cli.process import option_given, values_given
from odaf.cli.readers import require_file
from odaf.errors import ConfigError

if TYPE_CHECKING:
    from odaf.data.checks import Advice

AUTO = "auto"
AUTO_HELP = """usage: odaf train auto --data FILE --out DIR [options]

Look at the log, say which method to begin with and why, and train it.

The advice is that at the end of `odaf data check FILE`: a preset, and settings that fit the log. What you set yourself
goes before it. The run is that of `odaf train PRESET` with these settings; its config.json records preset and advice.
One data set at a time. docs/choosing.md says what the advice stands on, and where nothing was measured.

  odaf train auto --data log.h5 --out runs/auto --steps 20000 --seeds 0 1

The options are those of every preset (`odaf train behaviour-cloning --help`) and those of the preset that is
advised: `odaf train auto --data FILE --help` lists them for that log."""


def advised(arguments: list[str]) -> "Advice":
    """What is advised for the data set that the words of `odaf train auto` name; printed to the error stream.

    Raises:
        ConfigError: no data set is named, or several.
        DatasetError: the log has errors.
    """
    files = values_given(arguments, "--data")
    if not files:
        raise ConfigError("auto: --data: name the data set, as in `odaf train auto --data FILE --out DIR`")
    if len(files) > 1:
        raise ConfigError(
            f"auto: --data: {len(files)} files are named, and each may ask for another method; train each by itself, "
            "or see `odaf data check` of each and name a preset for all"
        )
    (file,) = files
    require_file(Path(file))

    from odaf.data.advise import advise

    with rows_bar("looking at the log") as progress:
        advice = advise(file, progress=None if "--quiet" in arguments else progress)
    print(f"{advice.describe(file, option_given(arguments, '--out') or 'DIR')}\n", file=sys.stderr)
    return advice
