"""Imports point one way through the rooms, and `import odaf` costs nothing."""

import ast
import subprocess
import sys
from pathlib import Path

import jaxtyping
import pytest

import odaf

PACKAGE = Path(odaf.__file__).parent

# A room may import from itself and from the rooms before it. `errors` is the bottom; `cli` the top.
ORDER = (
    "errors",
    "data",
    "components",
    "algorithms",
    "training",
    "environments",
    "evaluation",
    "runs",
    "report",
    "estimation",
    "deployment",
    "assessment",
    "behaviour",
    "theory",
    "studies",
    "cli",
)
# The package's own front and entry point look into every room by design.
FRONT = ("__init__", "__main__")


def room_of(module: str) -> str:
    """The room a dotted module name belongs to; the front for `odaf` itself."""
    parts = module.split(".")
    return parts[1] if len(parts) > 1 else "__init__"


def imported_names(source: str, package: str) -> list[tuple[int, str]]:
    """Every import in the source, those inside functions too, as (line, absolute dotted name).

    `from odaf.data import storage` is `odaf.data.storage`, whether that is a module or a name that the module offers.

    Args:
        package: dotted name of the package that holds the source; relative imports start there.
    """
    found: list[tuple[int, str]] = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            found += [(node.lineno, alias.name) for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                stem = package.split(".")[: len(package.split(".")) - node.level + 1]
                base = ".".join([*stem, base] if base else stem)
            found += [(node.lineno, f"{base}.{alias.name}") for alias in node.names]
    return found


def wrong_arrows(source: str, module: str, *, is_package: bool = False) -> list[str]:
    """The imports of one module that point to a room on its right, or to no known room."""
    room = room_of(module)
    package = module if is_package else module.rpartition(".")[0]
    findings: list[str] = []
    for line, target in imported_names(source, package):
        if not (target == "odaf" or target.startswith("odaf.")):
            continue
        other = room_of(target)
        if other in ("__version__", "__init__"):  # the version, and the bare front, are nobody's room
            continue
        if other not in ORDER:
            findings.append(f"{module}:{line} imports {target}, which is a public name; import it from its room")
        elif ORDER.index(other) > ORDER.index(room):
            findings.append(f"{module}:{line} imports {target}, but {room} comes before {other}")
    return findings


def modules() -> list[tuple[str, Path]]:
    """Dotted name and path of every module of the package."""
    found = []
    for path in sorted(PACKAGE.rglob("*.py")):
        parts = ["odaf", *path.relative_to(PACKAGE).with_suffix("").parts]
        found.append((".".join(parts[:-1] if parts[-1] == "__init__" else parts), path))
    return found


def circles(sources: dict[str, tuple[str, bool]]) -> list[list[str]]:
    """Groups of modules of which each leads to every other by imports, wherever in the file they stand.

    Args:
        sources: by dotted name: the source, and whether it is a package's `__init__`. An import of a name that is no
            module here leads to the module that offers it; the packages above a module are not counted.
    """

    def module_of(name: str) -> str:
        while name and name not in sources:
            name = name.rpartition(".")[0]
        return name

    leads_to = {
        module: {
            module_of(name) for _, name in imported_names(source, module if is_package else module.rpartition(".")[0])
        }
        - {module, ""}
        for module, (source, is_package) in sources.items()
    }

    def reachable(module: str) -> set[str]:
        seen: set[str] = set()
        waiting = [module]
        while waiting:
            new = leads_to[waiting.pop()] - seen
            seen |= new
            waiting += new
        return seen

    reached = {module: reachable(module) for module in sources}
    groups = {tuple(sorted(other for other in seen if module in reached[other])) for module, seen in reached.items()}
    return [list(group) for group in sorted(groups) if group]


def test_every_module_lives_in_a_known_room():
    unknown = {room_of(name) for name, _ in modules()} - {*ORDER, *FRONT}
    assert not unknown, f"rooms without a place in the import order: {sorted(unknown)}"


def test_imports_point_one_way():
    findings = [
        finding
        for name, path in modules()
        if room_of(name) not in FRONT
        for finding in wrong_arrows(path.read_text(), name, is_package=path.name == "__init__.py")
    ]
    assert not findings, "\n".join(findings)


def test_no_files_import_each_other_in_a_circle():
    # The fronts are looked through, not counted: `import odaf` loads names when they are first used.
    sources = {
        name: (path.read_text(), path.name == "__init__.py") for name, path in modules() if room_of(name) not in FRONT
    }
    found = circles(sources)
    assert not found, "\n".join(" <-> ".join(group) for group in found)


@pytest.mark.parametrize(
    "back",
    [
        "from odaf.data import log",
        "from odaf.data.log import Log",
        "import odaf.data.log",
        "from .log import Log",
        "def late():\n    from odaf.data.log import Log",
        "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from odaf.data.log import Log",
        "from odaf.data.readers import read",
    ],
)
def test_the_check_sees_a_planted_circle(back: str):
    sources = {
        "odaf.data": ("from odaf.data.dataset import Dataset", True),
        "odaf.data.log": ("from odaf.data import assembly", False),
        "odaf.data.assembly": ("from odaf.data.dataset import Dataset", False),
        "odaf.data.dataset": (back, False),
        "odaf.data.readers": ("from odaf.data.log import Log\ndef read(): ...", True),
    }
    (group,) = circles(sources)
    assert {"odaf.data.assembly", "odaf.data.dataset", "odaf.data.log"} <= set(group)
    assert not circles(
        sources | {"odaf.data.dataset": ("import numpy as np\nfrom odaf.errors import OdafError", False)}
    )


@pytest.mark.parametrize(
    "source",
    [
        "from odaf.training import fit",
        "import odaf.training.loop",
        "from odaf import training",
        "from odaf import Rollouts",
        "from ..training import loop",
        "from .. import training",
        "def late():\n    from odaf.cli import main",
    ],
)
def test_the_check_sees_a_wrong_arrow(source: str):
    assert wrong_arrows(source, "odaf.components.networks")


@pytest.mark.parametrize(
    "source",
    [
        "from odaf.data import Dataset",
        "from odaf.errors import ConfigError",
        "from odaf import errors",
        "from odaf import __version__",
        "from . import networks",
        "import numpy as np",
        "import odaf_tools",
    ],
)
def test_the_check_lets_right_arrows_pass(source: str):
    assert not wrong_arrows(source, "odaf.components.critics")


def loaded_after(statement: str) -> set[str]:
    """Top-level modules in a fresh interpreter after one statement."""
    code = f"{statement}\nimport sys\nprint(' '.join(sorted({{name.partition('.')[0] for name in sys.modules}})))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return set(done.stdout.split())


HEAVY = {"jax", "jaxlib", "equinox", "optax", "numpy", "scipy", "h5py", "polars", "matplotlib", "gymnasium"}


def test_importing_the_package_loads_no_array_library():
    assert not loaded_after("import odaf") & HEAVY


def test_importing_the_command_line_loads_no_array_library():
    assert not loaded_after("import odaf.cli") & HEAVY


@pytest.mark.parametrize("statement", ["import odaf.errors", "import odaf.data", "from odaf import Dataset"])
def test_data_on_the_host_loads_no_jax(statement: str):
    assert not loaded_after(statement) & {"jax", "jaxlib", "equinox", "optax"}


def test_importing_changes_no_environment_variable():
    code = "import os\nbefore = dict(os.environ)\nimport odaf, odaf.cli\nassert dict(os.environ) == before"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_public_names_are_listed_and_load():
    assert set(odaf.__all__) == {*odaf._HOME_OF, "__version__"}
    assert set(odaf.__all__) <= set(dir(odaf))
    for name in odaf.__all__:
        assert getattr(odaf, name) is not None


def test_an_unknown_public_name_is_explained():
    with pytest.raises(AttributeError, match="no attribute 'Datasett'; it offers"):
        odaf.__getattr__("Datasett")


def test_annotations_are_checked_while_the_tests_run():
    from odaf.cli.dispatch import is_group

    with pytest.raises(jaxtyping.TypeCheckError):
        is_group(3)  # type: ignore[arg-type]
