"""The run folder: names of files, tables of binary logs, and flights as arrays.

Import `run_folder.RunFolder` and `flight.Flight`. `harness.report` evaluates them.
"""
