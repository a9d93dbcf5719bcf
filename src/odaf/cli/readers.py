"""Options that say how a file of other people's is to be read; each layout takes those that concern it."""

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from odaf.errors import ConfigError

FormatName = Literal["d4rl", "minari", "ogbench", "d3rlpy", "lerobot", "parquet", "csv"]


@dataclass(frozen=True, kw_only=True)
class ReaderOptions:
    """How to read a file in another layout than our own. Tables need the names of their columns."""

    format: FormatName | None = None
    """The layout; without it, it is told from the contents."""
    observations: Annotated[tuple[str, ...] | None, tyro.conf.arg(metavar="NAME [NAME ...]")] = None
    """Columns (tables) or entries (Minari's dictionaries) of what was seen before the action."""
    observation: Annotated[tuple[str, ...], tyro.conf.UseAppendAction, tyro.conf.arg(metavar="NAME=FORMULA")] = ()
    """One more observation of a table, such as "error = level - setpoint"; may be given several times."""
    actions: Annotated[tuple[str, ...] | None, tyro.conf.arg(metavar="NAME [NAME ...]")] = None
    """Columns of what was done."""
    reward: Annotated[str | None, tyro.conf.arg(metavar="NAME|FORMULA")] = None
    """Column of what the action of the same row earned, or a formula over a table's columns, such as
    "1 - abs(level - setpoint)". For OGBench: zero, or an .npy file."""
    constant_reward: Annotated[float | None, tyro.conf.arg(metavar="NUMBER")] = None
    """For tables and LeRobot folders without rewards, in place of --reward: every row earned this. Enough for
    cloning."""
    goal: Annotated[tuple[float, float] | None, tyro.conf.arg(metavar="X Y")] = None
    """For OGBench's mazes: the reward is 0 near this place and -1 elsewhere, and the task ends there. For
    Minari's, recorded with many goals, the reward is 1 near this place and 0 elsewhere."""
    goal_radius: Annotated[float | None, tyro.conf.arg(metavar="NUMBER")] = None
    """How near; without it 1.0 for OGBench, as in its point mazes (0.5 in those of the ant and the humanoid), and 0.45
    for Minari."""
    episode: Annotated[str | None, tyro.conf.arg(metavar="NAME")] = None
    """Column of ids, equal for the rows of one episode."""
    single_episode: bool = False
    """In place of --episode: all rows of the table are one episode."""
    terminated: Annotated[str | None, tyro.conf.arg(metavar="NAME")] = None
    """Column that says where the task ended by itself."""
    never_terminated: bool = False
    """In place of --terminated: the task never ended by itself, every episode was cut."""
    truncated: Annotated[str | None, tyro.conf.arg(metavar="NAME")] = None
    """Column that says where the recording was cut."""
    time: Annotated[str | None, tyro.conf.arg(metavar="NAME")] = None
    """Column of times, in seconds or as dates."""
    next_observations: Annotated[tuple[str, ...] | None, tyro.conf.arg(metavar="NAME [NAME ...]")] = None
    """Columns of what was seen after the action; without them, the next row of the episode is taken."""
    infos: Annotated[tuple[str, ...] | None, tyro.conf.arg(metavar="NAME [NAME ...]")] = None
    """Further columns to keep beside the rows; learners do not see them."""
    action_bounds: Annotated[tuple[float, ...] | None, tyro.conf.arg(metavar="LOW HIGH [LOW HIGH ...]")] = None
    """Lowest and highest value: one pair for all actions, or a pair for each in their order."""
    units: Annotated[tuple[str, ...] | None, tyro.conf.arg(metavar="NAME=UNIT [NAME=UNIT ...]")] = None
    """Units of columns, such as level=m; the single word headings reads them from headings such as `level [m]`."""
    sort_by: Annotated[tuple[str, ...] | None, tyro.conf.arg(metavar="NAME [NAME ...]")] = None
    """Sort the rows of a table by these columns first."""
    on_gap: Literal["break", "error"] | None = None
    """Where rows are missing by the time column: begin a new episode (the default), or refuse the file."""
    time_step: Annotated[float | None, tyro.conf.arg(metavar="NUMBER")] = None
    """Usual time between two rows, in seconds or the unit of the time column; without it, each episode's median."""
    time_format: Annotated[str | None, tyro.conf.arg(metavar="TEXT")] = None
    """How dates are written where not by ISO 8601, such as "%d.%m.%Y %H:%M:%S"."""
    on_missing: Literal["error", "break", "nan"] | None = None
    """An empty cell: refuse the table (the default), leave out its row and cut the episode there, or keep it as NaN,
    so that a check counts it."""
    missing_values: Annotated[str | None, tyro.conf.arg(metavar="WORD[,WORD...]")] = None
    """What stands for a missing value in a table, beside an empty cell: "Bad,No Data" or -9999, in any case."""
    lags: Annotated[int | None, tyro.conf.arg(metavar="INT")] = None
    """So many earlier rows of a table's episode are seen too, as level_lag1, their actions included: against a dead
    time between an action and its effect. The first rows of each episode are left out."""
    differences: bool = False
    """The change of each observation since the row before is seen too, as level_change."""
    separator: Annotated[str | None, tyro.conf.arg(metavar="CHARACTER")] = None
    """What parts the cells of a CSV file, such as ";" or the word tab; without it, the headings tell."""
    decimal_comma: bool = False
    """The CSV file writes 1,5 for one and a half."""
    encoding: Annotated[str | None, tyro.conf.arg(metavar="NAME")] = None
    """How the CSV file writes letters, such as latin-1 or utf-16; without it, utf-8."""
    skip_rows: Annotated[int | None, tyro.conf.arg(metavar="INT")] = None
    """Lines in front of the CSV file's headings, empty ones and Excel's sep= aside; messages count them all."""
    units_row: bool = False
    """The row under the CSV file's headings holds units."""
    max_episode_steps: Annotated[int | None, tyro.conf.arg(metavar="INT")] = None
    """The environment's time limit, for D4RL files without time-outs."""
    d4rl_compat: bool = False
    """The rows that D4RL's own `qlearning_dataset` returns, for comparisons."""

    def files_read(self, file: Path) -> list[Path]:
        """Files and folders that a command reads: `file`, and one of rewards where --reward names that."""
        rewards = [] if self.reward is None or not Path(self.reward).is_file() else [Path(self.reward)]
        return [file, *rewards]

    def for_reader(self) -> dict[str, Any]:
        """Those options that were given, as `odaf.data.readers.read` takes them."""
        given = {field.name: getattr(self, field.name) for field in fields(ReaderOptions) if field.name != "format"}
        given = {name: value for name, value in given.items() if value is not None and value is not False}
        if not given["observation"]:
            del given["observation"]
        for column, instead in (
            ("reward", "constant_reward"),
            ("episode", "single_episode"),
            ("terminated", "never_terminated"),
        ):
            if column in given and instead in given:
                raise ConfigError(
                    f"--{column}: --{instead.replace('_', '-')} was given too; it is for logs that have no such "
                    "column: leave out one of the two"
                )
        if "constant_reward" in given:
            given["reward"] = given.pop("constant_reward")
        if given.pop("single_episode", False):
            given["episode"] = 0
        if given.pop("never_terminated", False):
            given["terminated"] = False
        if "observation" in given:
            given["observations"] = (*given.get("observations", ()), *given.pop("observation"))
        if "missing_values" in given:
            given["missing_values"] = [word.strip() for word in given["missing_values"].split(",") if word.strip()]
        if given.get("separator") in ("tab", "\\t"):
            given["separator"] = "\t"
        if "action_bounds" in given:
            given["action_bounds"] = _pairs(given["action_bounds"], self.actions)
        if "units" in given:
            given["units"] = _units(given["units"])
        return given


def require_file(path: Path) -> None:
    """Raises `ConfigError` where there is nothing at `path`."""
    if not path.exists():
        raise ConfigError(f"{path}: there is no such file; check the path, or make the data first")


def _pairs(numbers: tuple[float, ...], names: tuple[str, ...] | None) -> Any:
    if len(numbers) < 2 or len(numbers) % 2:
        raise ConfigError(f"--action-bounds: {len(numbers)} numbers were given; give pairs of lowest and highest value")
    if len(numbers) == 2:
        return numbers
    pairs = list(zip(numbers[::2], numbers[1::2], strict=True))
    if names is None:
        return tuple(numbers[::2]), tuple(numbers[1::2])
    if len(names) != len(pairs):
        raise ConfigError(
            f"--action-bounds: {len(pairs)} pairs for {len(names)} actions; give one pair, or one for each action"
        )
    return dict(zip(names, pairs, strict=True))


def _units(words: tuple[str, ...]) -> Any:
    if words == ("headings",):
        return "headings"
    odd = [word for word in words if "=" not in word]
    if odd:
        raise ConfigError(f"--units: {odd[0]!r} is no NAME=UNIT; write for instance level=m, or the word headings")
    return dict(word.split("=", 1) for word in words)
