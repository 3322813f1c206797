"""What a run is: scenario files, their settings, and errors in them.

Import `scenario.load` and `scenario.Scenario`. Settings of a vehicle, the radio and the antenna are defined
in their packages.
"""
