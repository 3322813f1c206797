"""Commands of a terminal: fly a scenario, run a campaign, export a NEC deck; progress and keys.

Import the module of a command. What a command does is left to the packages that it calls.
"""
