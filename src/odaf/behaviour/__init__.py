"""Behaviour policies of our own: trained online in the simulator, then shipped as small arrays."""
