"""What `phy`, `mac` and `ftm` share: settings, tables of state, events, the event queue, random streams.

Import `config` for the settings of a scenario's ``[radio]`` table. Behaviour is left to the three of them.
"""
