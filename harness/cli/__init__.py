"""Commands of a terminal: fly a scenario, show a run, run a campaign, export a NEC deck; progress and keys.

Import the module of a command. The commands call the other packages.
"""
