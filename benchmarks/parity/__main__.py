"""`python -m benchmarks.parity losses` and `python -m benchmarks.parity scores`; see the package."""

import argparse
from pathlib import Path

from benchmarks.parity.settings import LEARNERS


def main(arguments: list[str] | None = None) -> None:
    """Reads the command line and does one of the two."""
    parser = argparse.ArgumentParser(description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True)
    losses = commands.add_parser("losses", help="losses and gradients from equal weights on one batch")
    scores = commands.add_parser("scores", help="scores of both sides on one file of rows")
    for command in (losses, scores):
        command.add_argument("--learners", "--algorithms", nargs="+", default=list(LEARNERS), choices=list(LEARNERS))
        command.add_argument("--peer-python", type=Path, help="interpreter that has d3rlpy")
    scores.add_argument("--data", type=Path, help="file of rows, in any layout that odaf reads; without it, the table")
    scores.add_argument("--updates", type=int, default=20_000)
    scores.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2])
    scores.add_argument("--sides", nargs="+", default=["odaf", "d3rlpy"], choices=["odaf", "d3rlpy"])
    scores.add_argument("--folder", type=Path, default=Path(__file__).with_name("scores"), help="of the runs' files")
    options = parser.parse_args(arguments)
    if options.command == "losses":
        from benchmarks.parity.losses import main as compare

        raise SystemExit(compare(options.learners, options.peer_python))
    from benchmarks.parity import scores as of_scores

    if options.data is None:
        print(of_scores.table(options.folder))
        return
    of_scores.main(
        options.data,
        options.learners,
        options.seeds,
        options.updates,
        options.sides,
        options.peer_python,
        options.folder,
    )


if __name__ == "__main__":
    main()
