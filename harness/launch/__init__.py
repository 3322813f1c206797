"""Processes of a run: start, supervision, end; the Python interface `swarm.Swarm` and the pytest plugin.

Import `swarm` or `one_process`. The content of the processes is left to `autopilot`, `netsim` and
`harness.simulator`.
"""
