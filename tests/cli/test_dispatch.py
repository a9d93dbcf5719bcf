"""The command table: help, mistakes, exit codes, and what is printed where."""

import os
import resource
import signal
import subprocess
import sys

import pytest

from odaf import __version__
from odaf.cli import dispatch
from odaf.cli.dispatch import COMMANDS, Command, main, run_guarded
from odaf.errors import ConfigError


def raising(error: BaseException) -> Command:
    """A command that ends with the given error, put where the dispatcher will find it."""
    module = type(sys)("command_that_raises")

    def run(arguments: list[str]) -> None:
        raise error

    module.run = run  # type: ignore[attr-defined]
    sys.modules["command_that_raises"] = module
    return Command("probe", "", "", "command_that_raises")


def test_help_lists_every_command(capsys: pytest.CaptureFixture[str]):
    assert main(["--help"]) == 0
    out = capsys.readouterr().out
    for command in COMMANDS:
        assert f"  {command.name} " in out
        assert command.summary in out


def test_nothing_to_do_shows_the_help_and_fails(capsys: pytest.CaptureFixture[str]):
    assert main([]) == 2
    assert "usage: odaf" in capsys.readouterr().out


def test_help_on_a_group_lists_its_commands_only(capsys: pytest.CaptureFixture[str]):
    assert main(["data", "--help"]) == 0
    out = capsys.readouterr().out
    assert "data generate" in out
    assert "data info" in out
    assert "resume DIR" not in out


def test_version(capsys: pytest.CaptureFixture[str]):
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"odaf {__version__}\n"


@pytest.mark.parametrize(
    ("words", "hint"),
    [
        (["trian"], "there is no command `trian`; did you mean `odaf train`?"),
        (["data", "inof"], "there is no command `data inof`; did you mean `odaf data info`?"),
        (["data"], "there is no command `data`"),
        (["xyzzy"], "known are: data generate, data info"),
        (["--verbose"], "there is no command `--verbose`"),
    ],
)
def test_an_unknown_command_is_explained(words: list[str], hint: str, capsys: pytest.CaptureFixture[str]):
    assert main(words) == 2
    captured = capsys.readouterr()
    assert hint in captured.err
    assert captured.out == ""


def test_an_explained_mistake_prints_its_message_alone(capsys: pytest.CaptureFixture[str]):
    assert run_guarded(raising(ConfigError("field x: remedy")), [], debug=False) == 2
    assert capsys.readouterr().err == "odaf probe: field x: remedy\n"


def test_debug_shows_the_traceback_too(capsys: pytest.CaptureFixture[str]):
    assert run_guarded(raising(ConfigError("field x: remedy")), [], debug=True) == 2
    err = capsys.readouterr().err
    assert "Traceback (most recent call last)" in err
    assert err.endswith("odaf probe: field x: remedy\n")


def test_debug_is_understood_anywhere(capsys: pytest.CaptureFixture[str]):
    assert main(["data", "info", "no-such-file.h5", "--debug"]) == 2
    assert "Traceback" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("error", "message"),
    [
        (FileNotFoundError(2, "No such file or directory", "a.h5"), "a.h5: no such file or directory; check the path"),
        (PermissionError(13, "Permission denied", "a.h5"), "a.h5: permission denied; ask for access"),
        (OSError(28, "No space left on device"), "no space left on device"),
    ],
)
def test_file_system_errors_become_messages(error: OSError, message: str, capsys: pytest.CaptureFixture[str]):
    assert run_guarded(raising(error), [], debug=False) == 2
    assert message in capsys.readouterr().err


def test_a_defect_keeps_its_traceback():
    with pytest.raises(ZeroDivisionError):
        run_guarded(raising(ZeroDivisionError()), [], debug=False)


@pytest.mark.parametrize(("stop", "code"), [(SystemExit(2), 2), (SystemExit(None), 0), (SystemExit("x"), 1)])
def test_exits_of_the_option_parser_pass_through(stop: SystemExit, code: int):
    assert run_guarded(raising(stop), [], debug=False) == code


def test_an_interruption_says_how_to_go_on(capsys: pytest.CaptureFixture[str]):
    assert run_guarded(raising(KeyboardInterrupt("go on with: odaf resume r")), [], debug=False) == 130
    assert capsys.readouterr().err == "\nodaf probe: stopped; go on with: odaf resume r\n"


def odaf(*arguments: str, **options) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-m", "odaf", *arguments], capture_output=True, text=True, **options)


@pytest.mark.parametrize(
    ("words", "given", "threads"),
    [
        (["data", "generate"], None, "1"),
        (["evaluate"], "4", "4"),
        (["data", "check"], None, None),
    ],
)
def test_what_plays_step_by_step_has_one_thread_for_products(
    words: list[str], given: str | None, threads: str | None, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)  # so that what the command sets is taken back afterwards
    if given is not None:
        monkeypatch.setenv("OMP_NUM_THREADS", given)
    seen: list[str | None] = []

    def guarded(*_: object) -> int:
        seen.append(os.environ.get("OMP_NUM_THREADS"))
        return 0

    monkeypatch.setattr(dispatch, "run_guarded", guarded)
    assert main(words) == 0
    assert seen == [threads]
    os.environ.pop("OMP_NUM_THREADS", None)


def test_help_answers_within_a_second():
    """Measured in processor time, so that a busy machine does not count."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    assert odaf("--help").returncode == 0
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    assert (after.ru_utime + after.ru_stime) - (before.ru_utime + before.ru_stime) < 1.0


def test_every_command_has_help_without_jax():
    names = [command.name for command in COMMANDS]
    code = (
        "import sys\nfrom odaf.cli import main\n"
        f"for name in {names!r}:\n"
        "    assert main([*name.split(), '--help']) == 0, name\n"
        "    assert 'jax' not in sys.modules, f'{name} loads jax'"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert [name for name in names if f"usage: odaf {name} " not in done.stdout] == []


def test_every_study_is_planned_without_what_extras_bring():
    code = (
        "import sys\n"
        "for name in ('gymnasium', 'mujoco', 'gymnasium_robotics', 'matplotlib', 'jinja2', 'pyarrow', 'ray'):\n"
        "    sys.modules[name] = None\n"  # importing it raises ImportError
        "from odaf.studies.registry import STUDIES\n"
        "for study in STUDIES.values():\n"
        "    assert study.jobs(), study.name"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_a_mistake_leaves_the_process_with_code_2():
    done = odaf("data", "info", "no-such-file.h5")
    assert done.returncode == 2
    assert done.stdout == ""
    assert done.stderr.startswith("odaf data info: no-such-file.h5: ")
    assert len(done.stderr.splitlines()) == 1


def test_a_reader_that_goes_away_is_no_error(monkeypatch: pytest.MonkeyPatch):
    read, write = os.pipe()
    os.close(read)
    done = subprocess.run(
        [sys.executable, "-m", "odaf", "train", "--help"], stdout=write, stderr=subprocess.PIPE, text=True
    )
    os.close(write)
    assert done.returncode == dispatch.EXIT_BROKEN_PIPE
    assert done.stderr == ""


def test_a_real_interrupt_reaches_the_exit_code():
    code = (
        "import sys, time, types\n"
        "from odaf.cli.dispatch import Command, run_guarded\n"
        "def run(arguments):\n    print('ready', flush=True)\n    time.sleep(60)\n"
        "module = types.ModuleType('probe_module')\nmodule.run = run\nsys.modules['probe_module'] = module\n"
        "sys.exit(run_guarded(Command('probe', '', '', 'probe_module'), [], False))"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, bufsize=1
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "ready\n"
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=20)
    assert process.returncode == 130
    assert err == "\nodaf probe: stopped\n"


@pytest.mark.parametrize("command", ["demo", "reproduce"])
def test_long_commands_say_that_they_can_be_repeated(
    command: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    def interrupted(*arguments, **options):
        raise KeyboardInterrupt

    monkeypatch.setattr("odaf.studies.demo.run", interrupted)
    monkeypatch.setattr("odaf.studies.perform.perform", interrupted)
    assert main([command, *(["pointmaze"] if command == "reproduce" else [])]) == 130
    assert "repeat the command to go on" in capsys.readouterr().err
