"""Campaigns: many cases of one kind, over a grid or a random draw, on this machine or a cluster.

`specification` reads the file; `cases` makes its cases, each with a key; `executors` runs those
without a result in workers, which call `worker.run_case`; `store` has one file for each result;
`summary` and `page` show all of them. `kinds/case_kind` is the interface of the kinds.
"""
