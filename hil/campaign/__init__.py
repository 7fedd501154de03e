"""Campaigns: many cases of one kind, over a grid or a random draw, on one machine or a cluster.

`campaign_spec` reads the specification, `campaign_cases` makes the cases and their keys, an engine
of `engines/` runs them in workers (`case_worker`), `result_store` stores the results.
"""
