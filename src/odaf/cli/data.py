"""`odaf data generate` and `odaf data info`: make data sets, and look into them."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from odaf.cli.options import parse
from odaf.cli.results import number, table
from odaf.errors import ConfigError

if TYPE_CHECKING:
    from odaf.environments.stitch_data import StitchConfig


@dataclass(frozen=True)
class GenerateOptions:
    """Record a data set from scripted controllers.

    pointmaze-stitch: a point mass in a maze. No recorded episode takes the good path, yet its pieces are all there.
    """

    name: tyro.conf.Positional[Literal["pointmaze-stitch"]]
    """What to record."""
    out: Annotated[Path, tyro.conf.arg(metavar="FILE")]
    """File to write."""
    seed: int = 0
    """The same seed records the same data."""
    maze: Annotated[str, tyro.conf.arg(metavar="NAME|FILE")] = "stitch"
    """A known maze, or a JSON file with a map, its start and goal, and the routes to record (see docs/data.md)."""
    repeats: Annotated[int | None, tyro.conf.arg(metavar="INT")] = None
    """Episodes of each route; without it, the number that belongs to the maze."""


@dataclass(frozen=True)
class InfoOptions:
    """Say what a data set holds: sizes, returns, bounds, where it came from, what was changed on the way in."""

    file: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="FILE")]
    """A file of `odaf data generate`, or one in the D4RL layout."""
    json: bool = False
    """Print JSON."""


def generate(arguments: list[str]) -> None:
    """Entry point of `odaf data generate`."""
    options = parse(GenerateOptions, arguments, "data generate")

    from odaf.environments import stitch_data

    config = _config(options.maze)
    if options.repeats is not None:
        config = config.with_repeats(options.repeats)
    dataset = stitch_data.generate(config, options.seed)
    dataset.save(options.out)
    summary = dataset.summary()
    print(
        f"wrote {options.out}: {summary['episodes']:,} episodes, {summary['transitions']:,} transitions, "
        f"mean return {number(summary['mean_return'], 2)}, best {number(summary['best_return'], 2)}"
    )


def info(arguments: list[str]) -> None:
    """Entry point of `odaf data info`."""
    options = parse(InfoOptions, arguments, "data info")

    from odaf.data import Dataset

    dataset = Dataset.load(options.file)
    summary = {"file": str(options.file), "sha256": dataset.fingerprint(), **dataset.summary()}
    print(json.dumps(summary, indent=2) if options.json else describe(summary))


def describe(summary: Mapping[str, Any]) -> str:
    """A data set's summary for people."""
    provenance = summary["provenance"]
    environment = provenance.get("environment")
    facts = {
        "file": summary["file"],
        "fingerprint": summary["sha256"],
        "transitions": f"{summary['transitions']:,}",
        "episodes": f"{summary['episodes']:,}, mean length {number(summary['mean_length'])}",
        "return": f"mean {number(summary['mean_return'], 2)}, std {number(summary['std_return'], 2)}, "
        f"best {number(summary['best_return'], 2)}, worst {number(summary['worst_return'], 2)}",
        "ends": f"{summary['terminal_share']:.1%} of the episodes terminated, the others were cut",
        "observations": ", ".join(summary["observation_names"]),
        "environment": "unknown" if environment is None else environment.get("id", environment["name"]),
        "source": provenance.get("generator", "unknown"),
    }
    width = max(map(len, facts))
    lines = [f"{name:<{width}}  {text}" for name, text in facts.items()]
    bounds = zip(summary["action_names"], summary["action_low"], summary["action_high"], strict=True)
    lines += ["", table(["action", "low", "high"], [[name, f"{low:g}", f"{high:g}"] for name, low, high in bounds])]
    findings = provenance.get("findings", [])
    if findings:
        lines += ["", "changed on the way in:"]
        lines += [f"  {finding['finding']} ({finding['count']:,}): {finding['message']}" for finding in findings]
    return "\n".join(lines)


def _config(maze: str) -> "StitchConfig":
    """The configuration of a known maze, or the one in a JSON file."""
    from odaf.environments.stitch_data import CONFIGS, StitchConfig

    if maze in CONFIGS:
        return CONFIGS[maze]
    path = Path(maze)
    if not path.exists():
        raise ConfigError(f"--maze {maze}: neither a known maze ({', '.join(CONFIGS)}) nor a file")
    try:
        return StitchConfig.from_dict(json.loads(path.read_text(encoding="utf-8")))
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from error
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        raise ConfigError(
            f"{path}: does not describe a maze with its routes ({error}); compare it with the example in docs/data.md"
        ) from error
