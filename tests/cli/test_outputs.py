"""No command writes over what it reads, over other people's files, or two results to one place; results are whole."""

import os
import shutil
import threading
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from golden.tiny import linear_dataset
from odaf.cli import main
from odaf.data import Dataset, convert
from odaf.data.writing import write_text

# A command by the options that name its results; SOURCE stands for what it reads, OUT for the place in question.
FILE_COMMANDS = {
    "import": "data import SOURCE --observations a --actions b --reward c --episode d --out OUT",
    "import rewards": "data import THERE --reward SOURCE --out OUT",
    "check": "data check SOURCE --json OUT",
    "plot": "data plot SOURCE --out OUT",
    "split train": "data split SOURCE --train OUT --holdout OTHER",
    "split holdout": "data split SOURCE --train OTHER --holdout OUT",
    "mix expert": "data mix SOURCE THERE --ratio 0.5 --out OUT",
    "mix other": "data mix THERE SOURCE --ratio 0.5 --out OUT",
    "convert": "data convert SOURCE --to d4rl --out OUT",
    "convert to a folder": "data convert SOURCE --to minari --out OUT",
    "generate": "data generate pointmaze-stitch --maze SOURCE --out OUT",
    "evaluate": "evaluate RUN --knock slight --data SOURCE --json OUT",
    "evaluate, picture": "evaluate SOURCE --attack random --plot OUT",
    "report": "report SOURCE --out OUT",
}
PRECIOUS = "three years of measurements, of no kind that odaf knows\n"


def words(command: str, **places: Path) -> list[str]:
    return [str(places.get(word, word)) for word in FILE_COMMANDS.get(command, command).split()]


def spelled(how: str, path: Path) -> Path:
    """Another name for the file at `path`."""
    other = path.parent / "elsewhere" / f"name{path.suffix}"
    other.parent.mkdir()
    if how == "same":
        return path
    if how == "dotted":
        return other.parent / ".." / path.name
    if how == "link to the file":
        other.symlink_to(path)
        return other
    if how == "link to the folder":
        (path.parent / "mirror").symlink_to(path.parent)
        return path.parent / "mirror" / path.name
    os.link(path, other)
    return other


@pytest.mark.parametrize("how", ["same", "dotted", "link to the file", "link to the folder", "hard link"])
@pytest.mark.parametrize("force", [[], ["--force"]])
@pytest.mark.parametrize("command", FILE_COMMANDS)
def test_no_command_writes_over_what_it_reads(command, force, how, tmp_path, capsys):
    source, other = tmp_path / "source.png", tmp_path / "other.png"
    source.write_text(PRECIOUS)  # whoever read it first would complain about it
    out = spelled(how, source)
    (tmp_path / "there").write_text(PRECIOUS)
    given = words(command, SOURCE=source, OUT=out, OTHER=other, THERE=tmp_path / "there", RUN=tmp_path / "run")
    assert main([*given, *force]) == 2
    message = capsys.readouterr().err
    assert str(out) in message and "name another place" in message
    assert source.read_text() == PRECIOUS and not other.exists()


@pytest.mark.parametrize(
    "command",
    ["data split SOURCE --train OUT --holdout SAME", "evaluate SOURCE --attack random --json OUT --plot SAME"],
)
def test_two_results_in_one_place_are_refused(command, tmp_path, capsys):
    (tmp_path / "source.h5").write_text(PRECIOUS)
    same = tmp_path / "folder" / ".." / "out.png"
    (tmp_path / "folder").mkdir()
    places = {"SOURCE": tmp_path / "source.h5", "OUT": tmp_path / "out.png", "SAME": same}
    assert main(words(command, **places)) == 2
    assert "are one file" in capsys.readouterr().err
    assert not (tmp_path / "out.png").exists()


@pytest.fixture(scope="module")
def samples(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Files that commands can work on."""
    folder = tmp_path_factory.mktemp("samples")
    dataset = linear_dataset()
    dataset.save(folder / "set.h5")
    lines = ["level,valve,profit,batch", *(f"{np.sin(row)},{row % 7},{row % 5},{row // 20}" for row in range(80))]
    (folder / "log.csv").write_text("\n".join(lines) + "\n")
    return {"SET": folder / "set.h5", "LOG": folder / "log.csv"}


TABLE = "LOG --observations level --actions valve --reward profit --episode batch --accept actions-discrete"
RESULTS = {
    "import": (f"data import {TABLE} --out OUT", ".h5"),
    "check": ("data check SET --json OUT", ".json"),
    "plot": ("data plot SET --out OUT", ".html"),
    "split": ("data split SET --train OUT --holdout OTHER", ".h5"),
    "mix": ("data mix SET SET --ratio 0.5 --out OUT", ".h5"),
    "convert": ("data convert SET --to d4rl --out OUT", ".hdf5"),
    "generate": ("data generate pointmaze-stitch --repeats 1 --out OUT", ".h5"),
}


@pytest.mark.parametrize("command", RESULTS)
def test_results_are_replaced_whole_and_others_only_by_force(command, samples, tmp_path, capsys):
    text, suffix = RESULTS[command]
    out = tmp_path / f"out{suffix}"
    given = words(text, **samples, OUT=out, OTHER=tmp_path / "other.h5")

    out.write_text(PRECIOUS)
    assert main(given) == 2
    message = capsys.readouterr().err
    assert str(out) in message and "--force" in message
    assert out.read_text() == PRECIOUS and not (tmp_path / "other.h5").exists()

    # A second name of the old file keeps its content, so the new one was not written into its place bit by bit.
    os.link(out, tmp_path / "former")
    assert main([*given, "--force"]) == 0
    assert (tmp_path / "former").read_text() == PRECIOUS

    # The same command once more: its own earlier result may go.
    first = out.read_bytes()
    os.link(out, tmp_path / "earlier")
    assert main(given) == 0
    assert (tmp_path / "earlier").read_bytes() == first and not os.path.samefile(out, tmp_path / "earlier")
    assert not list(tmp_path.glob(".*"))


def test_a_link_stays_a_link_to_the_new_file(samples, tmp_path):
    (tmp_path / "store").mkdir()
    (tmp_path / "out.h5").symlink_to(tmp_path / "store" / "real.h5")
    assert main(words("data split SET --train OUT --holdout OTHER", **samples, OUT=tmp_path / "out.h5",
                      OTHER=tmp_path / "other.h5")) == 0  # fmt: skip
    assert (tmp_path / "out.h5").is_symlink()
    assert len(Dataset.load(tmp_path / "store" / "real.h5")) > 0


def test_a_minari_folder_is_replaced_by_force_alone(samples, tmp_path, capsys):
    given = words("data convert SET --to minari --out OUT", **samples, OUT=tmp_path / "folder")
    assert main(given) == 0
    (tmp_path / "folder" / "notes.txt").write_text(PRECIOUS)
    assert main(given) == 2 and "--force" in capsys.readouterr().err
    assert main([*given, "--force"]) == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["folder"]
    assert sorted(path.name for path in (tmp_path / "folder").iterdir()) == ["data"]


def test_a_folder_that_is_no_minari_set_is_not_even_replaced_by_force(samples, tmp_path, capsys):
    (tmp_path / "home").mkdir()
    (tmp_path / "home" / "notes.txt").write_text(PRECIOUS)
    given = words("data convert SET --to minari --out OUT --force", **samples, OUT=tmp_path / "home")
    assert main(given) == 2 and "remove it yourself" in capsys.readouterr().err
    assert (tmp_path / "home" / "notes.txt").read_text() == PRECIOUS


def test_a_folder_that_holds_the_source_is_not_replaced(tmp_path, capsys):
    folder = tmp_path / "tank"
    convert.to_minari(linear_dataset(), folder)
    linear_dataset().save(folder / "set.h5")
    assert main(words("data convert SET --to minari --out OUT --force", SET=folder / "set.h5", OUT=folder)) == 2
    assert "which the command reads" in capsys.readouterr().err
    assert (folder / "set.h5").exists()


@pytest.mark.parametrize("force", [[], ["--force"]])
@pytest.mark.parametrize(
    "command",
    [
        "report FOLDER --out MEMBER",
        "evaluate FOLDER --json MEMBER",
        "data import FOLDER --out MEMBER",
        "data check FOLDER --json MEMBER",
        "data convert FOLDER --to d4rl --out MEMBER",
    ],
)
def test_files_of_a_folder_that_is_read_stay(command, force, tmp_path, capsys):
    (tmp_path / "run" / "seed-0").mkdir(parents=True)
    member = tmp_path / "run" / "seed-0" / "summary.json"
    member.write_text('{"seed": 0}')
    assert main([*words(command, FOLDER=tmp_path / "run", MEMBER=member), *force]) == 2
    assert "which the command reads" in capsys.readouterr().err
    assert member.read_text() == '{"seed": 0}'


def test_a_page_beside_the_runs_it_shows_is_drawn_anew(tmp_path, capsys):
    (tmp_path / "run").mkdir()
    page = tmp_path / "run" / "report.html"
    page.write_text("<!doctype html><footer>Page made by odaf 0.1.0</footer>")
    assert main(["report", str(tmp_path / "run"), "--out", str(page)]) == 2
    assert "which the command reads" not in capsys.readouterr().err  # it is the run that is missing


def test_train_leaves_the_folder_of_its_data_alone(tmp_path, capsys):
    convert.to_minari(linear_dataset(), tmp_path / "tank")
    before = sorted(path.name for path in (tmp_path / "tank").iterdir())
    train = ["train", "behaviour-cloning", "--data", str(tmp_path / "tank"), "--out"]
    assert main([*train, str(tmp_path / "tank")]) == 2 and "is not empty" in capsys.readouterr().err
    file = tmp_path / "tank" / "data" / "main_data.hdf5"
    assert main([*train, str(file)]) == 2 and "is a file, not a directory" in capsys.readouterr().err
    assert sorted(path.name for path in (tmp_path / "tank").iterdir()) == before and file.is_file()


@pytest.mark.parametrize("name", ["report.html", "maze.png", "summary.json", "pointmaze-stitch.h5"])
def test_the_demo_leaves_other_files_alone(name, tmp_path, capsys):
    (tmp_path / name).write_text(PRECIOUS)
    assert main(["demo", "--out", str(tmp_path)]) == 2
    message = capsys.readouterr().err
    assert name in message and "--force" not in message
    assert [path.name for path in tmp_path.iterdir()] == [name] and (tmp_path / name).read_text() == PRECIOUS


@pytest.mark.parametrize(
    ("place", "reason"),
    [("", "is a folder"), ("missing/out.h5", "there is no folder"), ("file/out.h5", "cannot be written")],
)
def test_a_place_where_nothing_can_be_written_is_refused_first(place, reason, tmp_path, capsys):
    (tmp_path / "file").write_text(PRECIOUS)
    (tmp_path / "source.h5").write_text(PRECIOUS)
    given = words("data mix SOURCE SOURCE --ratio 0.5 --out OUT", SOURCE=tmp_path / "source.h5", OUT=tmp_path / place)
    assert main(given) == 2 and reason in capsys.readouterr().err


def test_a_device_is_not_replaced_by_a_file(samples, capsys):
    assert main(["data", "split", str(samples["SET"]), "--train", "/dev/null", "--holdout", "never.h5"]) == 2
    assert "is no file" in capsys.readouterr().err


def test_json_may_go_into_a_pipe(tmp_path):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    received: list[str] = []
    reader = threading.Thread(target=lambda: received.append(pipe.read_text()))
    reader.start()
    write_text(pipe, "content")
    reader.join(timeout=10)
    assert received == ["content"] and pipe.is_fifo()


def failing_writes(path: Path) -> dict[str, Callable[[], object]]:
    dataset = linear_dataset()

    def fail(done: int, total: int) -> None:
        raise ZeroDivisionError

    return {
        "data set": lambda: dataset.save(path, fail),
        "d4rl": lambda: convert.to_d4rl(dataset, path, fail),
        "minari": lambda: convert.to_minari(dataset, path, None, fail, replace=True),
    }


@pytest.mark.parametrize("kind", ["data set", "d4rl", "minari"])
def test_a_write_that_fails_midway_leaves_what_was_there(kind, tmp_path):
    place = tmp_path / "out"
    if kind == "minari":
        place.mkdir()
        (place / "former.txt").write_text(PRECIOUS)
    else:
        place.write_text(PRECIOUS)
    shutil.copytree(tmp_path, tmp_path.with_name(f"{tmp_path.name}-copy"))
    with pytest.raises(ZeroDivisionError):
        failing_writes(place)[kind]()
    assert [path.name for path in tmp_path.iterdir()] == ["out"]
    kept = place / "former.txt" if kind == "minari" else place
    assert kept.read_text() == PRECIOUS
