"""Run every benchmark and keep its figures: `python -m benchmarks`."""

from pathlib import Path

from benchmarks import (
    acting,
    ant_mazes,
    first_update,
    fitted_q,
    import_table,
    load_dataset,
    many_seeds,
    rollouts,
    updates_per_second,
)

if __name__ == "__main__":
    for script in (
        updates_per_second,
        first_update,
        many_seeds,
        import_table,
        load_dataset,
        acting,
        ant_mazes,
        fitted_q,
        rollouts,
    ):
        name = script.__name__.rpartition(".")[2]
        script.main(["--json", str(Path(__file__).parent / "last" / f"{name}.json")])
