"""Append-only binary logs of fixed-size records.

Import `record_log`. Record layouts are defined in the packages that write them.
"""
