"""Our learners beside d3rlpy's: equal losses from equal weights, and scores of both on the same data.

    python -m benchmarks.parity losses --peer-python .venv-peer/bin/python
    python -m benchmarks.parity scores --data hopper-medium.h5 --peer-python .venv-peer/bin/python

The peer runs in an interpreter of its own (`benchmarks/peer_d3rlpy.py` says how to make one); the two sides exchange
plain arrays. docs/results/parity.md says what was found.
"""
