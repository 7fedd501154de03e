"""Campaigns: many cases of one kind, over a grid or a draw, on one machine or a cluster.

`campaign_spec` reads the file, `campaign_cases` makes the cases and their keys, an engine of
`engines/` runs them in workers (`case_worker`), `result_store` keeps what they leave.
"""
