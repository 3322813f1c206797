"""One run: scenario, world, simulator, launch of the processes, records, report, campaigns, command line.

`launch.swarm.Swarm` is the Python interface to a run. The vehicles themselves are left to `autopilot`, the
channel to `netsim`, and validation of the results to `studies`.
"""
