"""Chooses the command, and turns every way a command can end into an exit code and one readable message.

Nothing heavy is imported here, so that help and mistakes answer at once.

Exit codes: 0 done, 1 a defect of odaf itself (with a traceback), 2 a mistake that the message explains,
130 stopped with Ctrl-C.
"""

import difflib
import os
import sys
import traceback
import warnings
from dataclasses import dataclass
from importlib import import_module
from typing import Any

from odaf import __version__
from odaf.cli import spelling
from odaf.cli.process import prepare_process
from odaf.errors import OdafError, OdafWarning

EXIT_MISTAKE = 2
EXIT_INTERRUPTED = 130
EXIT_BROKEN_PIPE = 141


@dataclass(frozen=True)
class Command:
    """One entry of the command table.

    Attributes:
        name: the words the user types after `odaf`.
        usage: what follows the name in the shortest call that does something.
        summary: one line for the table.
        module: module that offers `run(arguments) -> exit code or None`.
        function: name of that function.
    """

    name: str
    usage: str
    summary: str
    module: str
    function: str = "run"


COMMANDS = (
    Command(
        "data generate",
        "NAME --out FILE",
        "record a data set from controllers that come with odaf",
        "odaf.cli.data",
        "generate",
    ),
    Command("data info", "FILE", "say what a data set holds", "odaf.cli.data", "info"),
    Command("data import", "FILE --out FILE", "check a log of other people's and keep it", "odaf.cli.data_import"),
    Command("data check", "FILE", "say whether a log can be learned from", "odaf.cli.data_check"),
    Command("data plot", "FILE --out FILE", "draw returns, coverage and actions", "odaf.cli.data_plot"),
    Command("data split", "FILE --train FILE --holdout FILE", "set whole episodes aside", "odaf.cli.data_split"),
    Command("data mix", "EXPERT OTHER --ratio R --out FILE", "dilute expert data", "odaf.cli.data_mix"),
    Command("data convert", "FILE --to LAYOUT --out FILE", "write D4RL's or Minari's layout", "odaf.cli.data_convert"),
    Command("train", "PRESET --data FILE --out DIR", "learn policies from data sets", "odaf.cli.train"),
    Command("resume", "DIR", "go on with a run exactly where it stopped", "odaf.cli.resume"),
    Command("evaluate", "DIR", "play episodes with the policies of a run", "odaf.cli.evaluate"),
    Command("estimate", "RUN --data HOLDOUT", "say from a log alone what a policy is worth", "odaf.cli.estimate"),
    Command("export", "RUN --out DIR", "write a policy for ONNX, C and NumPy alone", "odaf.cli.export"),
    Command("guard", "RUN --data HOLDOUT", "let a policy say when it is out of its depth", "odaf.cli.guard"),
    Command("select", "RUN... --data HOLDOUT", "choose a run and a checkpoint from a log alone", "odaf.cli.select"),
    Command("assess", "RUN --data HOLDOUT", "may I run this? a verdict from a log, on one page", "odaf.cli.assess"),
    Command("report", "DIR... --out FILE", "draw one page that compares runs", "odaf.cli.report"),
    Command("compare", "DIR...", "say whether one run is better, and how sure", "odaf.cli.compare"),
    Command("cite", "METHOD...", "print the papers of a method", "odaf.cli.cite"),
    Command("behaviour train", "TASK --out DIR", "learn a policy to record data with", "odaf.cli.behaviour", "train"),
    Command("behaviour export", "DIR", "let `data generate` use such policies", "odaf.cli.behaviour", "export"),
    Command("demo", "", "stitch a maze from poor demonstrations, in minutes", "odaf.cli.demo"),
    Command("reproduce", "STUDY", "measure a whole study, one resumable command", "odaf.cli.reproduce"),
    Command("claims", "", "say which of the paper's claims the studies' records bear out", "odaf.cli.claims"),
)


# Played step by step, where a second thread for products of some hundred numbers waits more than it helps, and on a
# busy machine turns seconds into minutes.
PLAYING = ("data generate", "train", "resume", "evaluate", "behaviour train", "behaviour export", "demo", "reproduce")

# Fit networks, which on a GPU repeats to the bit only if it adds in a fixed order. `train` and `resume` ask for that
# themselves, for they know the run's device.
FITTING = ("estimate", "guard", "select", "assess", "behaviour train", "demo", "reproduce")


def main(arguments: list[str] | None = None) -> int:
    """Run one command.

    Args:
        arguments: words after `odaf`; taken from the process when not given.

    Returns:
        The exit code.
    """
    words = list(sys.argv[1:] if arguments is None else arguments)
    debug = "--debug" in words
    words = [word for word in words if word != "--debug"]
    if not words or words[0] in ("-h", "--help"):
        print(table_of_commands())
        return 0 if words else EXIT_MISTAKE
    if words[0] == "--version":
        print(f"odaf {__version__}")
        return 0
    command, rest = find_command(words)
    if command is None:
        if rest:
            print(table_of_commands(words[0]))
            return 0
        return complain("odaf", unknown_command(words))
    if command.name in PLAYING:  # read once, when NumPy is loaded; JAX has threads of its own
        os.environ.setdefault("OMP_NUM_THREADS", "1")
    if command.name in FITTING:
        prepare_process(None)
    return run_guarded(command, rest, debug)


def find_command(words: list[str]) -> tuple[Command | None, list[str]]:
    """The command that the first words name, and the words that are left for it.

    Without a command, the list holds the words of a request for help on a group (`odaf data --help`), else nothing.
    """
    for command in COMMANDS:
        name = command.name.split()
        if words[: len(name)] == name:
            return command, words[len(name) :]
    if is_group(words[0]) and words[1:] in (["-h"], ["--help"]):
        return None, words[1:]
    return None, []


def is_group(word: str) -> bool:
    """Whether several commands begin with this word."""
    return any(command.name.startswith(f"{word} ") for command in COMMANDS)


def run_guarded(command: Command, arguments: list[str], debug: bool) -> int:
    """Run a command; explained mistakes become their message and exit code 2.

    Args:
        debug: show the traceback of a mistake too.
    """
    name = f"odaf {command.name}"
    shown = warnings.showwarning

    def show(message: Warning | str, category: type[Warning], *place: Any, **options: Any) -> None:
        if issubclass(category, OdafWarning):
            print(f"{name}: warning: {spelling.spelled(str(message))}", file=sys.stderr)
        else:
            shown(message, category, *place, **options)

    try:
        run = getattr(import_module(command.module), command.function)
        warnings.showwarning = show
        code = int(run(arguments) or 0)
        sys.stdout.flush()
        return code
    except SystemExit as stop:  # the option parser prints its own message and stops with 0 or 2
        return stop.code if isinstance(stop.code, int) else int(stop.code is not None)
    except KeyboardInterrupt as stop:
        print(f"\n{name}: stopped{f'; {stop}' if str(stop) else ''}", file=sys.stderr)
        return EXIT_INTERRUPTED
    except BrokenPipeError:  # the reader of our output went away, as `head` does
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return EXIT_BROKEN_PIPE
    except (OdafError, OSError) as mistake:
        if debug:
            traceback.print_exc()
        return complain(name, describe(mistake) if isinstance(mistake, OSError) else spelling.explained(mistake))
    finally:
        warnings.showwarning = shown


def describe(error: OSError) -> str:
    """A file system error as place, cause and remedy."""
    cause = (error.strerror or str(error) or type(error).__name__).lower()
    if error.filename is None:
        return cause
    remedies = {
        FileNotFoundError: "check the path, or make the file first",
        IsADirectoryError: "name a file inside it",
        NotADirectoryError: "a part of the path is a file; name another place",
        PermissionError: "ask for access or name another place",
        FileExistsError: "name another place, or remove it first",
    }
    remedy = remedies.get(type(error))
    return f"{os.fsdecode(error.filename)}: {cause}" + (f"; {remedy}" if remedy else "")


def complain(name: str, message: str) -> int:
    """Print one message to the error stream; returns the exit code for an explained mistake."""
    sys.stdout.flush()
    print(f"{name}: {message}", file=sys.stderr)
    return EXIT_MISTAKE


def unknown_command(words: list[str]) -> str:
    """What to say about words that name no command, with the nearest one that exists."""
    if is_group(words[0]):
        known = [command.name for command in COMMANDS if command.name.startswith(f"{words[0]} ")]
        given = " ".join(words[:2])
    else:
        known = [command.name for command in COMMANDS]
        given = words[0]
    near = difflib.get_close_matches(given, known, n=1, cutoff=0.5)
    hint = f"did you mean `odaf {near[0]}`?" if near else f"known are: {', '.join(known)}"
    return f"there is no command `{given}`; {hint}"


def table_of_commands(group: str = "") -> str:
    """The help page: what odaf does, its commands, where to go next.

    Args:
        group: first word of the commands to list; all when empty.
    """
    chosen = [command for command in COMMANDS if not group or command.name.startswith(f"{group} ")]
    rows = [(f"{command.name} {command.usage}".strip(), command.summary) for command in chosen]
    width = max(len(left) for left, _ in rows)
    lines = "\n".join(f"  {left:<{width}}   {right}" for left, right in rows)
    return (
        f"usage: odaf {f'{group} ' if group else ''}COMMAND [options]\n\n"
        "Learn a control policy from logged data alone, even when the log comes from poor controllers.\n\n"
        f"commands:\n{lines}\n\n"
        "options:\n"
        "  -h, --help   this page; after a command, its own options\n"
        "  --version    the version\n"
        "  --debug      show the traceback behind an error message\n\n"
        "first steps:\n"
        "  odaf demo\n"
        "  odaf data generate pointmaze-stitch --seed 0 --out maze.h5\n"
        "  odaf train odaf --data maze.h5 --steps 20000 --seeds 0 1 --out runs/maze\n"
        "  odaf report runs/maze --out report.html"
    )
