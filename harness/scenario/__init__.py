"""Scenario files, their settings, and validation errors.

Import `scenario.load` and `scenario.Scenario`. The settings of vehicle, radio and antenna are defined
in their packages.
"""
