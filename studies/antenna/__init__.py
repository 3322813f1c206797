"""Validation of the antenna solvers against closed forms, two NEC2 programs and reference results.

Import `cli`, which makes docs/results/antenna-validation.md; `plan` lists the jobs and each other module is a
section or its figures. Solvers are in `antenna`, runner and report in `studies.common`.
"""
