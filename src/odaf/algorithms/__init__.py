"""Learners: one contract, one file each, registered by name."""
