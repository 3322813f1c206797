"""The swarm's synthetic-aperture antenna, a library of its own: geometry, patterns, statistics and plots."""
