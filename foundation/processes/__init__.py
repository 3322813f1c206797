"""Child processes: the protocol between child and parent, and a prefork server.

Import `child_protocol` in a program that a launcher starts, `prefork` in a prefork server. Swarms are started
and supervised by `harness.launch`.
"""
