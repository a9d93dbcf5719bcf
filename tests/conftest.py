"""Settings that hold for every test: run-time type checks, strict JAX, reproducible examples, one core a worker."""

import functools
import gc
import itertools
import os
import signal
from collections.abc import Callable, Iterator
from pathlib import Path


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
    os.environ["ODAF_TESTS_CORES"] = " ".join(map(str, available))  # for tests about the number of cores
    share = available[int(worker.removeprefix("gw")) :: count]
    if share:
        os.sched_setaffinity(0, share)


_own_cores()

# A shell's background jobs, and what nohup starts, ignore interrupts, which some tests send.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# Tests run small programs a few times, so that the compiler's optimisations cost more than they bring; the emitters of
# fused operations alone are two thirds of what is left. To cut a program into parts that cores compile side by side is
# work for nothing where a worker has one core. Processes that a test starts inherit this; the wheel's test trains as
# users do.
_COMPILE_FAST = (
    "--xla_backend_optimization_level=0",
    "--xla_llvm_disable_expensive_passes=true",
    "--xla_cpu_use_fusion_emitters=false",
    "--xla_cpu_parallel_codegen_split_count=1",
)
os.environ.setdefault("XLA_FLAGS", " ".join(_COMPILE_FAST))

import hypothesis  # noqa: E402
import jax  # noqa: E402
import jaxtyping  # noqa: E402
import optax  # noqa: E402
import pytest  # noqa: E402

# Every annotation of the package is checked while the tests run.
jaxtyping.install_import_hook("odaf", "typechecking.check")

jax.config.update("jax_numpy_rank_promotion", "raise")
jax.config.update("jax_numpy_dtype_promotion", "strict")
# Nobody reads in a test which line of Python an operation of a compiled program stems from; to gather that is slow.
jax.config.update("jax_traceback_in_locations_limit", 0)

# Tracing and lowering make many objects that live for a moment, through which Python's collector would go too often.
gc.set_threshold(50_000)

# Compiled programs are kept between runs, which saves most of a second run's time. A size limit makes JAX lock the
# folder, so that workers may share it. Processes that a test starts (and may kill) compile for themselves.
jax.config.update("jax_compilation_cache_dir", str(Path(__file__).parents[1] / ".cache" / "jax-tests"))
jax.config.update("jax_compilation_cache_max_size", 512 * 2**20)
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.5)


def _promoting_freely(function: Callable) -> Callable:
    """The function of another library, whose own promotions are not ours to judge."""

    @functools.wraps(function)
    def wrapped(*arguments, **options):
        with jax.numpy_dtype_promotion("standard"):
            return function(*arguments, **options)

    return wrapped


# Adam's bias correction raises a Python float to the power of an integer array; the schedule compares the two.
optax.tree.bias_correction = _promoting_freely(optax.tree.bias_correction)
_cosine_decay_schedule = optax.cosine_decay_schedule
optax.cosine_decay_schedule = lambda *arguments, **options: _promoting_freely(
    _cosine_decay_schedule(*arguments, **options)
)

hypothesis.settings.register_profile("local", deadline=None)
hypothesis.settings.register_profile("ci", deadline=None, derandomize=True)
hypothesis.settings.load_profile("ci" if os.environ.get("CI") else "local")

# JAX can watch that no random key is used twice, but then takes its slow way at every call. Where whole programs run,
# those of every learner among them, it watches; where formulas are computed operation by operation it costs a sixth.
_KEYS_ARE_WATCHED = ("battery", "behaviour", "estimation", "evaluation")


@pytest.fixture(autouse=True, scope="module")
def _random_keys_are_used_once(request: pytest.FixtureRequest) -> Iterator[None]:
    folder = request.path.relative_to(Path(__file__).parent).parts[0]
    jax.config.update("jax_debug_key_reuse", folder in _KEYS_ARE_WATCHED)
    yield
    jax.config.update("jax_debug_key_reuse", False)


# Most of the tests compile more programs than one process can hold.
_TESTS_BETWEEN = 20
_ended = itertools.count(1)


def pytest_runtest_teardown() -> None:
    from odaf.training.memory import forget_programs_in_time

    if next(_ended) % _TESTS_BETWEEN == 0:
        forget_programs_in_time()
