"""Damaged tables: whatever a byte, a heading or a type turns into, out comes a sound dataset or a typed error."""

import shutil

import numpy as np
import polars as pl
import pytest

from odaf.data import Dataset
from odaf.data.readers import lerobot, tables
from odaf.errors import ConfigError, DatasetError

ROWS = 24
ROLES = {
    "observations": ["level", "flow"],
    "actions": ["valve"],
    "reward": "profit",
    "episode": "batch",
    "terminated": "tripped",
    "time": "time",
    "action_bounds": {"valve": (0.0, 100.0)},
}


def tank() -> pl.DataFrame:
    index = np.arange(ROWS)
    return pl.DataFrame(
        {
            "batch": index // 6,
            "time": (index % 6) * 0.5,
            "level": np.sin(index),
            "flow": np.cos(index),
            "valve": 4.0 * index,
            "profit": -1.0 * index,
            "tripped": index % 12 == 11,
            "note": [f"row {number}" for number in index],
        }
    )


def robot() -> pl.DataFrame:
    index = np.arange(ROWS)
    return pl.DataFrame(
        {
            "observation.state": np.stack([np.sin(index), np.cos(index)], axis=1).astype(np.float32),
            "action": np.stack([0.1 * index, -0.1 * index], axis=1).astype(np.float32),
            "next.reward": index.astype(np.float32),
            "next.done": index % 12 == 11,
            "episode_index": index // 6,
            "frame_index": index % 6,
            "timestamp": (index % 6 / 10.0).astype(np.float32),
        }
    )


INFO = b"""{"codebase_version": "v2.1", "fps": 10, "total_frames": 24, "features":
 {"observation.state": {"dtype": "float32", "shape": [2], "names": ["x", "y"]},
  "action": {"dtype": "float32", "shape": [2], "names": {"motors": ["left", "right"]}}}}"""


def changed_type(rng: np.random.Generator, column: pl.Series) -> pl.Series:
    """The column as something else; lists stay as they are where they cannot become it."""
    makers = [
        lambda c: c.cast(pl.String),
        lambda c: c.cast(pl.Int8, strict=False),
        lambda c: c.cast(pl.Boolean, strict=False),
        lambda c: c.cast(pl.Float64) * 10.0 ** int(rng.integers(0, 300)),
        lambda c: pl.Series(c.name, [None] * len(c)),
        lambda c: pl.Series(c.name, [None if rng.random() < 0.2 else value for value in c.to_list()], dtype=c.dtype),
        lambda c: pl.Series(c.name, [[1.0] * int(rng.integers(0, 3)) for _ in range(len(c))]),
        lambda c: c.shuffle(seed=int(rng.integers(1 << 30))),
        lambda c: c.sort(descending=True),
        lambda c: c.cast(pl.Int32, strict=False).cast(pl.Date, strict=False),
        lambda c: pl.Series(c.name, [{"a": value} for value in c.to_list()]),
        lambda c: pl.Series(c.name, [f"{value}".encode() for value in c.to_list()]),
        lambda c: c.cast(pl.String).cast(pl.Categorical),
        lambda c: c.fill_null(0).replace_strict({}, default=np.nan, return_dtype=pl.Float64),
    ]
    try:
        return makers[rng.integers(len(makers))](column).alias(column.name)
    except (pl.exceptions.PolarsError, TypeError):
        return column


def changed_frame(rng: np.random.Generator, frame: pl.DataFrame) -> pl.DataFrame:
    """Columns renamed, left out, retyped; rows left out or repeated."""
    for _ in range(rng.integers(1, 4)):
        name = frame.columns[rng.integers(frame.width)]
        kind = rng.integers(5)
        if kind == 0:
            new = name[: rng.integers(len(name) + 1)] + str(rng.integers(10))
            frame = frame if new in frame.columns else frame.rename({name: new})
        elif kind == 1 and frame.width > 1:
            frame = frame.drop(name)
        elif kind == 2:
            frame = frame.with_columns(changed_type(rng, frame[name]))
        elif kind == 3:
            frame = (
                frame[np.sort(rng.integers(0, max(frame.height, 1), rng.integers(0, ROWS)))] if frame.height else frame
            )
        else:
            frame = frame.sample(fraction=1.0, shuffle=True, seed=int(rng.integers(1 << 30)))
    return frame


def changed_bytes(rng: np.random.Generator, content: bytes) -> bytes:
    """Bytes replaced, cut off, repeated or put in."""
    data = bytearray(content)
    kind = rng.integers(4)
    if kind == 0:
        return bytes(data[: rng.integers(len(data))])
    for _ in range(rng.integers(1, 12)):
        place = int(rng.integers(len(data)))
        if kind == 1:
            data[place] ^= 1 << int(rng.integers(8))
        elif kind == 2:
            data[place] = int(rng.choice(list(b',;"\n\t0-.[\x00\xff')))
        else:
            data[place:place] = data[max(0, place - int(rng.integers(40))) : place]
    return bytes(data)


def save(frame: pl.DataFrame, path) -> None:
    """As CSV or Parquet; columns that CSV cannot hold are left out."""
    if path.suffix == ".parquet":
        frame.write_parquet(path)
        return
    plain = [name for name, dtype in frame.schema.items() if not dtype.is_nested() and dtype != pl.Binary]
    frame.select(plain).write_csv(path)


def attempt(read) -> bool:
    """Whether a dataset came out; then it is sound. Anything but our own errors goes through."""
    try:
        dataset = Dataset.from_log(read())
    except (DatasetError, ConfigError) as error:
        assert len(str(error)) < 5_000
        return False
    assert np.isfinite(dataset.observations).all() and np.isfinite(dataset.rewards).all()
    assert (dataset.terminated | dataset.truncated).sum() == dataset.num_episodes
    return True


def changed_options(rng: np.random.Generator, form: str) -> dict[str, object]:
    """What a caller may ask of a table; some of it fits the roles, some does not."""
    choices: list[dict[str, object]] = [
        {"on_missing": "nan"},
        {"on_missing": "break"},
        {"missing_values": ["Bad", "-3", "nan", ""]},
        {"time": None},
        {"lags": int(rng.integers(0, 8))},
        {"differences": True},
        {"reward": "1 - abs(level - flow) / valve"},
        {"observations": ["level", "error = level - flow", "root = sqrt(error)"]},
        {"sort_by": [str(name) for name in rng.choice(["batch", "time", "level", "note", "profit"], 2)]},
        {"infos": ["note", "profit", "time"][: int(rng.integers(1, 4))]},
        {"episode": "note" if rng.random() < 0.5 else 0},
        {"units": "headings"},
        {"next_observations": ["flow", "level"]},
    ]
    if form == "csv":
        choices += [{"units_row": True}, {"decimal_comma": True}, {"skip_rows": 1}, {"encoding": "latin-1"}]
    options: dict[str, object] = {"on_missing": "break"} if rng.random() < 0.5 else {}
    for _ in range(rng.choice([0, 0, 1, 1, 2, 3])):
        options |= choices[rng.integers(len(choices))]
    return options


def changed_text(rng: np.random.Generator, content: bytes) -> bytes:
    """Lines and cells as other programs write them."""
    lines = content.decode().splitlines()
    for _ in range(rng.integers(0, 4)):
        place = int(rng.integers(len(lines)))
        words = ["", "Bad", "1,5", "2.000e+00", "True", "#NV", "NaN", " 3 ", "9" * 30, "-0", "inf", "1 days 00:00:01"]
        word = str(rng.choice(words))
        kind = rng.integers(5)
        if kind == 0:
            lines.insert(place, str(rng.choice(["", ",,,,,,,", "  ", "sep=,", "s,m,-,-,%,EUR,-,-", '"'])))
        elif kind == 1 and lines[place]:
            cells = lines[place].split(",")
            cells[rng.integers(len(cells))] = word
            lines[place] = ",".join(cells)
        elif kind == 2:
            lines = [line.replace(",", ";").replace(".", ",") for line in lines]
        elif kind == 3 and len(lines[0].split(",")) > 1:
            column = int(rng.integers(len(lines[0].split(","))))
            rows = [line.split(",") for line in lines]
            lines = [
                ",".join([*row[:column], word, *row[column + 1 :]]) if n else ",".join(row)
                for n, row in enumerate(rows)
            ]
        else:
            lines.insert(0, "sep=;" if rng.random() < 0.5 else "")
    return "\n".join([*lines, ""]).encode()


def fuzz_file(form: str, count: int, folder) -> int:
    """Mutates a table `count` times, half of them as bytes; returns how many still gave a dataset."""
    path, sound = folder / f"log.{form}", 0
    for seed in range(count):
        rng = np.random.default_rng(seed)
        if seed % 2:
            save(changed_frame(rng, tank()), path)
            if form == "csv" and seed % 4 == 1:
                path.write_bytes(changed_text(rng, path.read_bytes()))
        else:
            save(tank(), path)
            path.write_bytes(changed_bytes(rng, path.read_bytes()))
        options = changed_options(rng, form)
        sound += attempt(lambda options=options: tables.read(path, **{**ROLES, **options}))
    return sound


def fuzz_frame(form: str, count: int, folder) -> int:
    """The same for frames and mappings in memory."""
    sound = 0
    for seed in range(count):
        rng = np.random.default_rng(seed)
        frame = changed_frame(rng, tank())
        whole = frame if seed % 2 else {name: frame[name].to_numpy() for name in frame.columns}
        options = {**ROLES, **changed_options(rng, form)}
        sound += attempt(lambda whole=whole, options=options: tables.from_frame(whole, **options))
    return sound


def fuzz_lerobot(form: str, count: int, folder) -> int:
    """The same for a folder: two Parquet files, or their description."""
    sound = 0
    for seed in range(count):
        rng = np.random.default_rng(seed)
        root = folder / "robot"
        shutil.rmtree(root, ignore_errors=True)
        (root / "data" / "chunk-000").mkdir(parents=True)
        (root / "meta").mkdir()
        paths = [root / "data" / "chunk-000" / f"file-{index:03d}.parquet" for index in range(2)]
        parts = [robot()[:12], robot()[12:]]
        info = INFO
        kind = rng.integers(3)
        if kind == 0:
            info = changed_bytes(rng, info)
        elif kind == 1:
            parts[rng.integers(2)] = changed_frame(rng, parts[0])
        for path, part in zip(paths, parts, strict=True):
            save(part, path)
        if kind == 2:
            victim = paths[rng.integers(2)]
            victim.write_bytes(changed_bytes(rng, victim.read_bytes()))
        (root / "meta" / "info.json").write_bytes(info)
        sound += attempt(lambda root=root: lerobot.read(root))
    return sound


FUZZERS = {"csv": fuzz_file, "parquet": fuzz_file, "frame": fuzz_frame, "lerobot": fuzz_lerobot}


@pytest.mark.parametrize("form", FUZZERS)
def test_damaged_tables_end_in_our_own_errors(form, tmp_path):
    sound = FUZZERS[form](form, 150, tmp_path)
    assert 0 < sound < 150  # some damage is harmless, most is noticed


@pytest.mark.slow
@pytest.mark.parametrize("form", FUZZERS)
def test_two_thousand_damaged_tables_end_in_our_own_errors(form, tmp_path):
    sound = FUZZERS[form](form, 2_000, tmp_path)
    print(f"{form}: {sound} of 2000 mutations still give a dataset")
    assert 0 < sound < 2_000
