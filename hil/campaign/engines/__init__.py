"""Engines that bring cases to workers: processes of this machine, dask, submitit."""
