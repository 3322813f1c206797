"""One run: scenario, world, simulator, launch of the processes, records, report, campaigns, command line.

`launch.swarm.Swarm` is the Python interface to a run. `autopilot` contains the vehicles, `netsim` the
channel, and `studies` the validation of the results.
"""
