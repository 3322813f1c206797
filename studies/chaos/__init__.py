"""The chaos study: real flights with random faults of their processes, judged by how they end.

`faults` draws them from a seed, `requirements` states how a flight with one has to end, `flight` flies and
judges one by `launcher` and `small_disk`, `side_by_side` flies several at the same time, `records` keeps them
in a file, `page` forms the tables. Not needed to fly; nothing imports this folder but the command line.
"""
