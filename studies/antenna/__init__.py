"""Validation of the antenna solvers against closed forms, two NEC2 programs and reference results."""
