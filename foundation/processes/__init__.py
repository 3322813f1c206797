"""Child processes: the protocol between child and parent, a prefork server, owners of sockets.

Import `child_protocol` in a program that a launcher starts, `prefork` in a prefork server, and
`socket_owners` for users and processes at addresses of this machine. Swarms are started and supervised by
`harness.launch`.
"""
