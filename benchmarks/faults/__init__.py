"""Sound logs of many kinds, and the same logs with a fault planted: what `benchmarks/check_faults.py` judges by."""
