"""Estimates many scans with HyperQueue, and compares sets of results.

`scans` finds scan files, `task` makes the command line and the request of resources for each, `engine` gives them to HyperQueue,
`outcomes` reads how they ended, `summary` and `compare` write tables and pages.
"""
