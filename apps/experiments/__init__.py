"""The machinery of ``warpdef experiment``: sequences and settings become runs, runs become tables.

Plan -> paper_experiments, own_experiments -> Experiment -> session (here, or cluster) -> Store -> report, plot
"""
