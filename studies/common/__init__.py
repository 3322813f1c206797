"""Shared parts of the studies: command line, jobs in worker processes, checks, tables and Markdown reports.

Import `runner` and `report`. Each study supplies the content of its report.
"""
