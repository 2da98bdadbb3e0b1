"""Data sets of a run's trajectories, for other people's tools: `python -m memtransfer.export --help`.

Each module writes one format through the library of that format. The guide is `docs/datasets.md` of the project.
"""
