"""Run every benchmark and keep its figures: `python -m benchmarks`."""

from pathlib import Path

from benchmarks import updates_per_second

if __name__ == "__main__":
    updates_per_second.main(["--json", str(Path(__file__).parent / "last" / "updates_per_second.json")])
