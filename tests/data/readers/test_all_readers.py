"""What every reader owes: recorded successors, episodes kept apart, and nothing but our errors on damaged files."""

import codecs
import contextlib
import faulthandler
import json
import shutil
import sys
import time

import h5py
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from data.readers.layouts import LAYOUTS, LOSES_LAST, OTHERS, episodes_of
from odaf.data import Dataset, readers
from odaf.errors import DatasetError


def assert_recorded(name, dataset, episodes):
    """Every transition is a recorded step of one episode, with the recorded action and, where it goes on, successor."""
    found = np.zeros((len(episodes), 9), bool)
    for row in range(len(dataset)):
        number, step = divmod(int(dataset.observations[row, 0]), 1000)
        episode = episodes[number]
        found[number, step] = True
        np.testing.assert_array_equal(dataset.observations[row], episode["observations"][step])
        np.testing.assert_array_equal(dataset.actions[row], episode["actions"][step])
        if name != "ogbench":
            assert dataset.rewards[row] == episode["rewards"][step]
        if not dataset.terminated[row]:
            np.testing.assert_array_equal(dataset.next_observations[row], episode["observations"][step + 1])
        last = step == len(episode["rewards"]) - 1
        assert dataset.terminated[row] == (last and episode["terminated"] and name != "ogbench")
    lengths = [len(episode["rewards"]) for episode in episodes]
    lost = [not e["terminated"] and name in LOSES_LAST for e in episodes]
    np.testing.assert_array_equal(found.sum(axis=1), np.array(lengths) - lost)
    assert dataset.num_episodes == sum(length > gone for length, gone in zip(lengths, lost, strict=True))


@pytest.mark.parametrize("name", [*LAYOUTS, *OTHERS])
@settings(max_examples=25)
@given(lengths=st.lists(st.integers(1, 8), min_size=1, max_size=6), seed=st.integers(0, 9), block=st.integers(1, 9))
def test_successors_are_the_recorded_ones_and_stay_inside_episodes(tmp_path_factory, name, lengths, seed, block):
    write, read, options = (LAYOUTS | OTHERS)[name]
    episodes = episodes_of(lengths, seed)
    log = read(write(tmp_path_factory.mktemp("any"), episodes), **options)
    assert log.format == name.split("-")[0]
    assert_recorded(name, Dataset.from_log(log), episodes)
    blocks = [columns for _, columns in log.blocks(block)]
    for field, column in log.columns.items():
        np.testing.assert_array_equal(np.concatenate([columns[field] for columns in blocks]), column[:])
        assert (column.shape, column.dtype) == (column[:].shape, column[:].dtype)


def test_no_reader_is_missing_above():
    assert {name.split("-")[0] for name in LAYOUTS | OTHERS} == {*readers.FORMATS, "frame", "episodes", "odaf"}


def flip_bytes(path, rng):
    content = bytearray(path.read_bytes())
    for place in rng.integers(len(content), size=rng.integers(1, 9)):
        content[place] = rng.integers(256)
    path.write_bytes(content)


def cut(path, rng):
    content = path.read_bytes()
    path.write_bytes(content[: rng.integers(len(content))])


def overwrite_stretch(path, rng):
    """Copies one stretch of the file over another, as a disk that mixes up its blocks would."""
    content = bytearray(path.read_bytes())
    length = int(rng.integers(1, min(512, len(content))))
    source, target = rng.integers(len(content) - length, size=2)
    content[target : target + length] = content[source : source + length] if rng.random() < 0.5 else bytes(length)
    path.write_bytes(content)


def change_field(path, rng):
    """Renames, removes, reshapes, cuts or retypes one field, keeping the container intact."""
    if path.suffix == ".json":
        content = json.loads(path.read_text())
        name = str(rng.choice(sorted(content)))
        value = content.pop(name)
        content[name if rng.random() < 0.7 else name + "x"] = [value, {}, None, -1, "{}", "[" * 9][rng.integers(6)]
        path.write_text(json.dumps(content))
    elif path.suffix == ".npz":
        with np.load(path) as file:
            fields = dict(file)
        change_one(fields, rng)
        np.savez(path, **fields)
    elif path.suffix == ".arrow":
        import pyarrow as pa
        from pyarrow import ipc

        with ipc.open_file(path.read_bytes()) as file:
            table = file.read_all()
        column = int(rng.integers(table.num_columns))
        name = table.column_names[column]
        choice = rng.integers(4)
        if choice == 0:
            table = table.rename_columns([other + "x" * (other == name) for other in table.column_names])
        elif choice == 1:
            table = table.slice(0, int(rng.integers(table.num_rows)))
        elif choice == 2:
            table = table.set_column(column, name, pa.array([None, *["a"] * (table.num_rows - 1)]))
        else:
            table = table.set_column(column, name, table.column(int(rng.integers(table.num_columns))))
        with ipc.new_file(path, table.schema) as file:
            file.write_table(table)
    else:
        with h5py.File(path, "r+") as file:
            names = []
            file.visititems(lambda name, item: names.append(name) if isinstance(item, h5py.Dataset) else None)
            name = str(rng.choice(names))
            fields = {name: np.asarray(file[name])}
            del file[name]
            change_one(fields, rng)
            for name, values in fields.items():
                file[name] = values


def change_one(fields, rng):
    name = str(rng.choice(sorted(fields)))
    values = np.asarray(fields.pop(name))
    changes = [
        lambda: {name + "x": values},
        lambda: {},
        lambda: {name: values[: len(values) // 2] if values.ndim else np.zeros(3)},
        lambda: {name: values.reshape(-1)},
        lambda: {name: values[None]},
        lambda: {name: np.full(values.shape, b"abc")},
        lambda: {name: np.full(values.shape, np.nan)},
        lambda: {name: np.full(values.shape, 2**62)},
        lambda: {name: np.zeros(values.shape, np.complex64)},
        lambda: {name: np.zeros((0, *values.shape[1:]))},
        lambda: {name: np.zeros((*values.shape, 0))},
        lambda: {f"{name}/below": values} if "/" not in name else {name + "/below": values},
    ]
    fields.update(changes[rng.integers(len(changes))]())


MUTATIONS = (flip_bytes, flip_bytes, cut, overwrite_stretch, change_field)


class Watch:
    """Notes when Python unpickles, starts a program or loads a library; switched on around reads."""

    EVENTS = ("pickle.find_class", "exec", "os.system", "subprocess.Popen", "os.exec", "ctypes.dlopen", "marshal.loads")
    on = False
    seen: tuple = ()

    @classmethod
    def hook(cls, event, arguments):
        if cls.on and event in cls.EVENTS:
            cls.seen = (*cls.seen, (event, str(arguments)[:200]))


@pytest.fixture(scope="module")
def watch():
    codecs.lookup("ascii")  # h5py encodes names by it, and Python loads that codec at first use
    sys.addaudithook(Watch.hook)
    return Watch


def attempt(path, options, layout):
    """Reads a file as a user would; the layout is named in every second attempt, as if it had not been recognised."""
    with contextlib.suppress(DatasetError):
        Dataset.from_log(readers.read(path, format=layout, **options))
        return True
    return False


def fuzz(tmp_path, watch, name, count):
    write, _, options = LAYOUTS[name]
    (tmp_path / "sound").mkdir()
    sound = write(tmp_path / "sound", episodes_of([3, 2]))
    assert attempt(sound, options, None)
    read, slowest = 0, 0.0
    faulthandler.dump_traceback_later(600 + 2 * count, exit=True)  # a hang in a library cannot be interrupted otherwise
    try:
        for seed in range(count):
            rng = np.random.default_rng([seed, *name.encode()])
            shutil.rmtree(tmp_path / "damaged", ignore_errors=True)
            shutil.copytree(tmp_path / "sound", tmp_path / "damaged")
            path = tmp_path / "damaged" / sound.name
            files = sorted(entry for entry in path.rglob("*") if entry.is_file()) if path.is_dir() else [path]
            mutation, target = MUTATIONS[rng.integers(len(MUTATIONS))], files[rng.integers(len(files))]
            mutation(target, rng)
            begin = time.process_time()
            watch.on = True
            try:
                read += attempt(path, options, name.split("-")[0] if seed % 2 else None)
            except Exception as error:
                raise AssertionError(
                    f"{name}, seed {seed}: {mutation.__name__} on {target.name} gave {error!r}"
                ) from error
            finally:
                watch.on = False
            slowest = max(slowest, time.process_time() - begin)
    finally:
        faulthandler.cancel_dump_traceback_later()
    assert watch.seen == ()
    assert slowest < 5, f"{name}: one file took {slowest:.1f} s of computing time"
    assert 0 < read < 3 * count / 4  # the rest hits what nobody reads, or numbers that may be anything
    return read, slowest


@pytest.mark.parametrize("name", LAYOUTS)
def test_damaged_files_give_nothing_but_our_errors(tmp_path, watch, name):
    fuzz(tmp_path, watch, name, 150)


@pytest.mark.slow
@pytest.mark.parametrize("name", LAYOUTS)
def test_many_damaged_files_give_nothing_but_our_errors(tmp_path, watch, name):
    read, slowest = fuzz(tmp_path, watch, name, 2_000)
    print(f"{name}: {read} of 2,000 damaged files could be read, the slowest took {slowest:.2f} s")
