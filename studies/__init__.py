"""What makes docs/results: validation and benchmarks of vehicle, radio and antenna, the article's figures.

Each folder is one study with its own command line over `common`. Flying needs none of them, and no package of
coflight imports them.
"""
