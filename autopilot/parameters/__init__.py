"""Settings of a vehicle (`config`) and its PX4 parameters: table, files, documentation, inert parameters.

Import `config.AutopilotConfig` or `table.ParameterSet`. The settings of each package are defined there.
"""
