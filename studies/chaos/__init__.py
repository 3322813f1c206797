"""The chaos study: real flights with random faults of their processes, judged by how they end.

`faults` draws them from a seed, `flight` flies and judges one, `page` forms the table. Not needed to fly;
nothing imports this folder but the command line.
"""
