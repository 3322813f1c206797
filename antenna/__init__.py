"""The swarm's synthetic-aperture antenna: geometry, NEC2 patterns, statistics and plots. A library of its own."""
