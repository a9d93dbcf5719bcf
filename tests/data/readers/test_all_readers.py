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

from odaf.data import readers
from odaf.errors import DatasetError


def episodes_of(lengths, seed=0):
    """Episodes of so many steps with one observation more; the first entry of an observation is its own number."""
    rng = np.random.default_rng(seed)
    result = []
    for number, steps in enumerate(lengths):
        observations = rng.normal(size=(steps + 1, 3)).astype(np.float32)
        observations[:, 0] = 1000 * number + np.arange(steps + 1)
        result.append(
            {
                "observations": observations,
                "actions": rng.uniform(-1, 1, (steps, 2)).astype(np.float32),
                "rewards": rng.normal(size=steps).astype(np.float32),
                "terminated": bool(number % 2 == 0),
            }
        )
    return result


def joined(episodes, field, stop=None):
    return np.concatenate([episode[field][:stop] for episode in episodes])


def ends(episodes, terminated):
    return np.concatenate(
        [np.arange(len(e["rewards"])) == len(e["rewards"]) - 1 if e["terminated"] is terminated
         else np.zeros(len(e["rewards"]), bool) for e in episodes]
    )  # fmt: skip


def write_d4rl(path, episodes, successors=True):
    path = path / "file.hdf5"
    with h5py.File(path, "w") as file:
        file["observations"] = joined(episodes, "observations", -1)
        file["actions"], file["rewards"] = joined(episodes, "actions"), joined(episodes, "rewards")
        file["terminals"], file["timeouts"] = ends(episodes, True), ends(episodes, False)
        if successors:
            file["next_observations"] = np.concatenate([e["observations"][1:] for e in episodes])
        file["infos/qpos"] = joined(episodes, "observations", -1)
        file["metadata/policy/fc0/weight"] = np.zeros((3, 4))
        file["metadata/policy/nonlinearity"] = "relu"
        file["metadata/algorithm"] = np.bytes_("SAC")
    return path


def write_d4rl_packed(path, episodes):
    plain = write_d4rl(path, episodes, successors=False)
    packed = path / "packed.hdf5"
    with h5py.File(plain) as source, h5py.File(packed, "w") as file:
        for name in ("observations", "actions", "rewards", "terminals", "timeouts"):
            file.create_dataset(name, data=np.asarray(source[name]), chunks=True, compression="gzip")
    plain.unlink()
    return packed


def metadata_of(episodes):
    box = {"type": "Box", "dtype": "float32", "shape": [2], "low": [-1.0, -1.0], "high": [1.0, 1.0]}
    return {
        "total_episodes": len(episodes),
        "total_steps": sum(len(e["rewards"]) for e in episodes),
        "action_space": json.dumps(box),
        "env_spec": json.dumps({"id": "Hopper-v5", "entry_point": "os:system", "kwargs": {}}),
    }


def write_minari_hdf5(path, episodes):
    folder = path / "set" / "data"
    folder.mkdir(parents=True)
    (folder / "metadata.json").write_text(json.dumps({**metadata_of(episodes), "data_format": "hdf5"}))
    with h5py.File(folder / "main_data.hdf5", "w", track_order=True) as file:
        for number in reversed(range(len(episodes))):  # neither in order nor without gaps
            episode, group = episodes[number], file.create_group(f"episode_{2 * number}")
            group.attrs["id"] = 2 * number
            for name, values in minari_fields(episode).items():
                group.create_dataset(name, data=values, chunks=True, maxshape=(None, *values.shape[1:]))
    return path / "set"


def minari_fields(episode):
    steps = len(episode["rewards"])
    last = np.arange(steps) == steps - 1
    return {
        "observations/goal": episode["observations"][:, :1],
        "observations/state": episode["observations"][:, 1:],
        "actions": episode["actions"],
        "rewards": episode["rewards"].astype(np.float64),
        "terminations": last & episode["terminated"],
        "truncations": last & (not episode["terminated"]),
        "infos/qpos": episode["observations"],
    }


def write_minari_arrow(path, episodes):
    pa = pytest.importorskip("pyarrow")
    from pyarrow import ipc

    folder = path / "set" / "data"
    folder.mkdir(parents=True)
    (folder / "metadata.json").write_text(json.dumps({**metadata_of(episodes), "data_format": "arrow"}))

    def rows(values):
        return pa.FixedSizeListArray.from_arrays(values.reshape(-1), type=pa.list_(pa.float32(), values.shape[1]))

    for number, episode in enumerate(episodes):
        fields = minari_fields(episode)
        padded = {
            name: np.concatenate([fields[name], np.zeros_like(fields[name][:1])])
            for name in ("actions", "rewards", "terminations", "truncations")
        }
        goal, state = rows(fields["observations/goal"]), rows(fields["observations/state"].copy())
        table = pa.table(
            {
                "observations": pa.StructArray.from_arrays([goal, state], names=["goal", "state"]),
                "actions": rows(padded["actions"]),
                **{name: padded[name] for name in ("rewards", "terminations", "truncations")},
                "infos": pa.StructArray.from_arrays([rows(fields["infos/qpos"])], names=["qpos"]),
            }
        )
        (folder / str(number)).mkdir()
        with ipc.new_file(folder / str(number) / "part-0.arrow", table.schema) as file:
            file.write_table(table)
    return path / "set"


def write_ogbench(path, episodes):
    """All T + 1 observations are stored; the action of the last row has no meaning."""
    fields = {
        "observations": joined(episodes, "observations"),
        "actions": np.concatenate([np.append(e["actions"], e["actions"][-1:], axis=0) for e in episodes]),
        "terminals": np.concatenate([np.arange(len(e["observations"])) == len(e["rewards"]) for e in episodes]),
        "qpos": joined(episodes, "observations"),
    }
    np.savez_compressed(path / "file.npz", **fields)
    return path / "file.npz"


def write_d3rlpy(path, episodes):
    """An episode that did not terminate stores its T + 1 observations as T + 1 rows, the last one without successor."""
    with h5py.File(path / "file.h5", "w") as file:
        file["columns"] = ["observations", "actions", "rewards", "terminated"]
        file["num_episodes"], file["version"] = len(episodes), "2.1"
        for number, episode in enumerate(episodes):
            extra = [] if episode["terminated"] else [-1]
            file[f"observations_{number}"] = episode["observations"][: len(episode["rewards"]) + len(extra)]
            for name in ("actions", "rewards"):
                values = np.concatenate([episode[name], episode[name][extra]])
                file[f"{name}_{number}"] = values if values.ndim == 2 else values[:, None]
            file[f"terminated_{number}"] = episode["terminated"]
    return path / "file.h5"


# name: (writer, options of the reader)
LAYOUTS = {
    "d4rl": (write_d4rl, {}),
    "d4rl-packed": (write_d4rl_packed, {}),
    "minari-hdf5": (write_minari_hdf5, {"observations": ["goal", "state"]}),
    "minari-arrow": (write_minari_arrow, {"observations": ["goal", "state"]}),
    "ogbench": (write_ogbench, {"reward": "zero"}),
    "d3rlpy": (write_d3rlpy, {"action_bounds": (-1.0, 1.0)}),
}


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
    lost = [not e["terminated"] and name == "d4rl-packed" for e in episodes]  # its last successors are not recorded
    np.testing.assert_array_equal(found.sum(axis=1), np.array(lengths) - lost)
    assert dataset.num_episodes == sum(length > gone for length, gone in zip(lengths, lost, strict=True))


@pytest.mark.parametrize("name", LAYOUTS)
@settings(max_examples=25)
@given(lengths=st.lists(st.integers(1, 8), min_size=1, max_size=6), seed=st.integers(0, 9), block=st.integers(1, 9))
def test_successors_are_the_recorded_ones_and_stay_inside_episodes(tmp_path_factory, name, lengths, seed, block):
    write, options = LAYOUTS[name]
    episodes = episodes_of(lengths, seed)
    path = write(tmp_path_factory.mktemp("any"), episodes)
    log = readers.read(path, **options)
    assert log.format == name.split("-")[0]
    assert_recorded(name, log.to_dataset(), episodes)
    blocks = [columns for _, columns in log.blocks(block)]
    for field, column in log.columns.items():
        np.testing.assert_array_equal(np.concatenate([columns[field] for columns in blocks]), column[:])
        assert (column.shape, column.dtype) == (column[:].shape, column[:].dtype)


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
        readers.read(path, format=layout, **options).to_dataset()
        return True
    return False


def fuzz(tmp_path, watch, name, count):
    write, options = LAYOUTS[name]
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
