"""`odaf data generate` and `odaf data info`: make data sets, and look into them."""

import json
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from odaf.cli.interrupts import repeatable
from odaf.cli.options import parse
from odaf.cli.outputs import DATASET, check_outputs
from odaf.cli.results import number, print_report, table
from odaf.errors import ConfigError

if TYPE_CHECKING:
    from odaf.data import Dataset
    from odaf.environments.stitch_data import StitchConfig


@dataclass(frozen=True)
class GenerateOptions:
    """Record a data set from scripted controllers, or from the policies that come with odaf.

    pointmaze-stitch: a point mass in a maze. No recorded episode takes the good path, yet its pieces are all there.
    antmaze-...: an ant that is led through a maze, told as attempts at one goal.
    The others: a running body, played by policies of the level that the name says; docs/reference/generated-data.md
    describes each.
    """

    name: tyro.conf.Positional[
        Literal[
            "pointmaze-stitch",
            "halfcheetah-random",
            "halfcheetah-medium",
            "halfcheetah-medium-replay",
            "halfcheetah-medium-expert",
            "halfcheetah-expert",
            "hopper-random",
            "hopper-medium",
            "hopper-medium-replay",
            "hopper-medium-expert",
            "hopper-expert",
            "walker2d-random",
            "walker2d-medium",
            "walker2d-medium-replay",
            "walker2d-medium-expert",
            "walker2d-expert",
            "antmaze-umaze",
            "antmaze-umaze-diverse",
            "antmaze-medium-play",
            "antmaze-medium-diverse",
            "antmaze-large-play",
            "antmaze-large-diverse",
        ]
    ]
    """What to record."""
    out: Annotated[Path, tyro.conf.arg(metavar="FILE")]
    """File to write."""
    seed: int = 0
    """The same seed records the same data."""
    maze: Annotated[str | None, tyro.conf.arg(metavar="NAME|FILE")] = None
    """pointmaze only: a known maze, or a JSON file with a map, its start and goal, and the routes to record (see
    docs/how-to/record-data.md); without it, stitch."""
    repeats: Annotated[int | None, tyro.conf.arg(metavar="INT")] = None
    """pointmaze only: episodes of each route; without it, the number that belongs to the maze."""
    transitions: Annotated[int | None, tyro.conf.arg(metavar="INT")] = None
    """Locomotion and ant mazes: rows to record; without it, 100,000. D4RL's ant mazes have 1,000,000."""
    version: Annotated[Literal["v4", "v5"] | None, tyro.conf.arg(metavar="v4|v5")] = None
    """Locomotion only: environment version; without it, v4, near which scores were published."""
    edition: Annotated[int | None, tyro.conf.arg(metavar="INT")] = None
    """Locomotion only: edition of the set, where a better policy was found for its level since; without it, the
    newest."""
    contact_margins: Annotated[Literal["added", "larger"] | None, tyro.conf.arg(metavar="RULE")] = None
    """How MuJoCo counts the contact margins of two parts that touch: `added`, as it does from 3.5.0 on, or `larger`, as
    before, which makes Hopper and the point mazes the older bodies; without it, as the
    installed one does, and `larger` for ant mazes."""
    exact: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None
    """medium-replay only: train a policy from scratch in this directory, which takes hours, and keep its true replay
    buffer; a run that is there is gone on with."""
    force: bool = False
    """Write over a file of another kind, if one is there."""


@dataclass(frozen=True)
class InfoOptions:
    """Say what a data set holds: sizes, returns, bounds, where it came from, what was changed on the way in.

    For a file that `odaf data import` wrote also what the checks found then, and which errors were accepted.
    """

    file: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="FILE")]
    """A file of ours, or one in any layout that says itself what its columns mean."""
    json: bool = False
    """Print JSON."""


def generate(arguments: list[str]) -> None:
    """Entry point of `odaf data generate`."""
    options = parse(GenerateOptions, arguments, "data generate")
    check_outputs({"--out": (options.out, DATASET)}, [_map_file(options), options.exact], options.force)
    began = time.monotonic()
    record = _maze_data if options.name == "pointmaze-stitch" else _locomotion_data
    dataset = (_ant_maze_data if options.name.startswith("antmaze-") else record)(options)
    seconds = time.monotonic() - began
    dataset.save(options.out)
    summary = dataset.summary()
    print(
        f"wrote {options.out}: {summary['episodes']:,} episodes, {summary['transitions']:,} transitions, "
        f"mean return {number(summary['mean_return'], 2)}, best {number(summary['best_return'], 2)}"
    )
    statistics = summary["provenance"]["statistics"]
    if "normalised_mean" in statistics:
        print(
            f"{statistics['environment']}: normalised score {number(statistics['normalised_mean'])} over "
            f"{statistics['whole_episodes']:,} whole episodes; {summary['transitions'] / seconds:,.0f} transitions/s"
        )
    if "reached_share" in statistics:
        print(
            f"{statistics['whole_walks']:,} whole walks: {statistics['reached_share']:.0%} reached their own goal, "
            f"{statistics['flipped_share']:.0%} ended on their back; {statistics['goal_walks']:,} ended at the goal of "
            "evaluation; "
            f"{summary['transitions'] / seconds:,.0f} transitions/s"
        )
    for finding in summary["provenance"]["findings"]:
        print(f"{finding['finding']}: {finding['message']}")


def info(arguments: list[str]) -> None:
    """Entry point of `odaf data info`."""
    options = parse(InfoOptions, arguments, "data info")

    from odaf.data import Dataset, fingerprint

    dataset = Dataset.load(options.file)
    summary = {"file": str(options.file), **fingerprint.record(dataset), **dataset.summary()}
    if options.json:
        print(json.dumps(summary, indent=2))
        return
    print(describe(summary))

    from odaf.data.ingestion import stored_report

    if (stored := stored_report(dataset)) is not None:
        report, accepted = stored
        print("\nwhat the checks found before the import, rows as in the source:")
        print_report(report)
        if accepted:
            print(f"errors accepted: {', '.join(accepted)}")


def describe(summary: Mapping[str, Any]) -> str:
    """A data set's summary for people."""
    from odaf.data.readers.minari_environment import shown
    from odaf.environments.contact_margins import in_words, recorded

    provenance = summary["provenance"]
    environment = provenance.get("environment")
    facts = {
        "file": summary["file"],
        "fingerprint": summary["rows_sha256"],
        "whole file": summary["sha256"],
        "transitions": f"{summary['transitions']:,}",
        "episodes": f"{summary['episodes']:,}, mean length {number(summary['mean_length'])}",
        "return": f"mean {number(summary['mean_return'], 2)}, std {number(summary['std_return'], 2)}, "
        f"best {number(summary['best_return'], 2)}, worst {number(summary['worst_return'], 2)}{_fragments(summary)}",
        "reward per step": f"mean {number(summary['mean_reward'], 4)}, "
        f"best episode {number(summary['best_mean_reward'], 4)}, worst {number(summary['worst_mean_reward'], 4)}",
        "ends": f"{summary['terminal_share']:.1%} of the episodes terminated, the others were cut",
        "observations": ", ".join(summary["observation_names"]),
        "environment": "unknown" if environment is None else shown(environment),
        **({"recorded in": shown(provenance["recorded_environment"])} if "recorded_environment" in provenance else {}),
        "simulator": in_words(recorded(provenance)) or "not recorded",
        "source": provenance.get("generator") or provenance.get("file") or "unknown",
    }
    policies = provenance.get("policies")
    if isinstance(policies, Mapping) and "edition" in policies:
        facts["edition"] = f"{policies['edition']} of the shipped policies"
    if isinstance(provenance.get("mixture"), Mapping):
        facts["mixture"] = _mixture(provenance["mixture"], summary.get("mixture"))
    width = max(map(len, facts))
    lines = [f"{name:<{width}}  {text}" for name, text in facts.items()]
    bounds = zip(summary["action_names"], summary["action_low"], summary["action_high"], strict=True)
    lines += ["", table(["action", "low", "high"], [[name, f"{low:g}", f"{high:g}"] for name, low, high in bounds])]
    findings = provenance.get("findings", [])
    if findings:
        lines += ["", "changed on the way in:"]
        lines += [f"  {finding['finding']} ({finding['count']:,}): {finding['message']}" for finding in findings]
    return "\n".join(lines)


def _fragments(summary: Mapping[str, Any]) -> str:
    """Says which episodes best and worst leave out."""
    count = summary["fragments"]
    return f" (without {count:,} {'fragment' if count == 1 else 'fragments'} cut short)" if count else ""


def _mixture(content: Mapping[str, Any], drawn: Mapping[str, Any] | None) -> str:
    """How two data sets were mixed, and how batches are drawn from them."""
    if drawn is None:
        rows = " and ".join(f"{part['rows']:,} rows of the {part['role']} data" for part in content["parts"])
        return f"{content['construction']}, ratio {content['ratio']:g}: {rows}"
    return (
        f"per batch: each row comes from the {drawn['border']:,} rows of the first part, or with probability "
        f"{drawn['ratio']:g} from those after them"
    )


def _maze_data(options: GenerateOptions) -> "Dataset":
    for field in ("transitions", "version", "edition", "exact"):
        if getattr(options, field) is not None:
            raise ConfigError(f"--{field} is for locomotion; a maze takes --maze and --repeats")

    from odaf.environments import stitch_data

    config = _config(options.maze or "stitch")
    if options.repeats is not None:
        config = config.with_repeats(options.repeats)
    return stitch_data.generate(config, options.seed, options.contact_margins)


def _ant_maze_data(options: GenerateOptions) -> "Dataset":
    for field in ("maze", "repeats", "version", "edition", "exact"):
        if getattr(options, field) is not None:
            raise ConfigError(f"--{field} does not apply to {options.name}, which takes --transitions")

    from odaf.training.progress import default_progress

    try:
        from odaf.environments.ant_maze_data import generate
    except ImportError as error:
        raise ConfigError(
            f'{options.name}: needs a simulator that is missing ({error}); pip install "odaf[envs]"'
        ) from error
    return generate(
        options.name,
        100_000 if options.transitions is None else options.transitions,
        options.seed,
        default_progress(True),
        contact_margins=options.contact_margins,
    )


def _locomotion_data(options: GenerateOptions) -> "Dataset":
    for field in ("maze", "repeats"):
        if getattr(options, field) is not None:
            raise ConfigError(f"--{field} is for mazes; {options.name} takes --transitions and --version")

    from odaf.training.progress import default_progress

    version, progress = options.version or "v4", default_progress(True)
    if options.exact is not None:
        if options.transitions is not None:
            raise ConfigError("--transitions: the buffer of a training run is as long as its training; leave it out")
        if options.edition is not None:
            raise ConfigError("--edition: the buffer of a training run holds its own policies; leave it out")

        from odaf.behaviour.exact_replay import exact_replay

        with repeatable():
            return exact_replay(options.name, options.exact, options.seed, version, progress, options.contact_margins)

    from odaf.environments.locomotion_data import generate

    transitions = 100_000 if options.transitions is None else options.transitions
    return generate(
        options.name,
        transitions,
        options.seed,
        version,
        progress,
        contact_margins=options.contact_margins,
        edition=options.edition,
    )


def _map_file(options: GenerateOptions) -> Path | None:
    """The file that describes the maze, where one was named."""
    return None if options.maze is None or not Path(options.maze).is_file() else Path(options.maze)


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
            f"{path}: does not describe a maze with its routes ({error}); compare it with the example in "
            "docs/how-to/record-data.md"
        ) from error
