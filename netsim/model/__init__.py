"""State shared by `phy`, `mac` and `ftm`: settings, tables, events, the event queue, random streams.

Import `config` for the settings of a scenario's ``[radio]`` table. The models themselves are in those three.
"""
