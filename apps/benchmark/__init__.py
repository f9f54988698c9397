"""The machinery of ``warpdef bench``: sizes, beds, rows, peers, sweeps and tables."""
