"""Engines that run cases in workers: processes of this machine, dask, submitit."""
