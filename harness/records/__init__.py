"""The run folder: names of files, tables made from binary logs, and flights as arrays.

Import `run_folder.RunFolder` and `flight.Flight`. Evaluating them is left to `harness.report`.
"""
