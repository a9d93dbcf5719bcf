"""Control policies from logged data of poor or mixed quality.

The names below are the promise of this package; everything else may move. They are loaded when first used, so
`import odaf` is quick and imports no array library.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

_HOME_OF = {
    "CheckpointError": "odaf.errors",
    "ConfigError": "odaf.errors",
    "Dataset": "odaf.data",
    "DatasetError": "odaf.errors",
    "DivergenceError": "odaf.errors",
    "OdafError": "odaf.errors",
}

if TYPE_CHECKING:
    from odaf.data import Dataset
    from odaf.errors import CheckpointError, ConfigError, DatasetError, DivergenceError, OdafError

__all__ = [
    "CheckpointError",
    "ConfigError",
    "Dataset",
    "DatasetError",
    "DivergenceError",
    "OdafError",
    "__version__",
]


def __getattr__(name: str) -> Any:
    home = _HOME_OF.get(name)
    if home is None:
        raise AttributeError(f"module 'odaf' has no attribute {name!r}; it offers {', '.join(sorted(_HOME_OF))}")
    value = getattr(import_module(home), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *_HOME_OF})
