"""What studies share: command line, jobs in worker processes, requirements, tables and Markdown reports.

Import `runner` and `report`. The content of a report is left to each study.
"""
