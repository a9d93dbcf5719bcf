"""Settings that hold for every test: run-time type checks, strict JAX, reproducible examples, one core a worker."""

import os


def _own_cores() -> None:
    """Give each of several parallel workers its own share of the cores.

    Otherwise every worker starts as many XLA threads as there are cores, and they slow one another down.
    Must happen before JAX starts its thread pool. A single worker keeps all cores.
    """
    worker = os.environ.get("PYTEST_XDIST_WORKER", "")
    count = int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1"))
    if count == 1 or not worker.startswith("gw") or not hasattr(os, "sched_setaffinity"):
        return
    available = sorted(os.sched_getaffinity(0))
    share = available[int(worker.removeprefix("gw")) :: count]
    if share:
        os.sched_setaffinity(0, share)


_own_cores()

import hypothesis  # noqa: E402
import jax  # noqa: E402
import jaxtyping  # noqa: E402

# Every annotation of the package is checked while the tests run.
jaxtyping.install_import_hook("odaf", "beartype.beartype")

jax.config.update("jax_numpy_rank_promotion", "raise")
jax.config.update("jax_numpy_dtype_promotion", "strict")

hypothesis.settings.register_profile("local", deadline=None)
hypothesis.settings.register_profile("ci", deadline=None, derandomize=True)
hypothesis.settings.load_profile("ci" if os.environ.get("CI") else "local")
