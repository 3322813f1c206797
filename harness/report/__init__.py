"""Results of a run: summary, formation errors, antenna gains and figures, computed from the run folder.

Import `report.finish`. `harness.campaign` and `studies` evaluate many runs.
"""
