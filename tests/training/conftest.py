"""The tiny learner as a fixture; it is registered for the length of a test, so that runs of it can be reloaded."""

import importlib.util
import sys
from pathlib import Path

import pytest

_NAME = "odaf_tests_tiny_learner"


@pytest.fixture(scope="session")
def _tiny_module():
    path = Path(__file__).with_name("tiny_learner.py")
    spec = importlib.util.spec_from_file_location(_NAME, path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[_NAME] = module
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def tiny(_tiny_module, monkeypatch):
    from odaf.algorithms.registry import ALGORITHMS

    monkeypatch.setitem(ALGORITHMS._known, "tiny", _tiny_module.TinyLearner)
    return _tiny_module
