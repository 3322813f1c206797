"""Settings of a vehicle (`config`) and its PX4 parameters: table, files, documentation, inert parameters.

Import `config.AutopilotConfig` or `table.Parameters`. The settings of each part are defined beside that part.
"""
