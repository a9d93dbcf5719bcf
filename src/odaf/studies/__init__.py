"""Studies: what is measured with many runs, one resumable command each, and the ledger of their records."""
