"""What a run comes to: summary, formation errors, antenna gains and figures, computed from the run folder.

Import `report.write_report`. Statements over many runs are left to `harness.campaign` and `studies`.
"""
