"""The check that drawing and page-making libraries are there, made before anything is read or written."""

from importlib.util import find_spec

from odaf.errors import ConfigError


def check_extra(needed: tuple[str, ...] = ("matplotlib", "jinja2")) -> None:
    """Passes where everything `needed` can be imported.

    Raises:
        ConfigError: naming what is missing and the command that installs it.
    """
    missing = [name for name in needed if not _present(name)]
    if missing:
        raise ConfigError(f'{" and ".join(missing)} not installed; the report needs it: pip install "odaf[report]"')


def _present(name: str) -> bool:
    try:
        return find_spec(name) is not None
    except ValueError:  # the name is bound to a module without a spec, or to nothing
        return False
