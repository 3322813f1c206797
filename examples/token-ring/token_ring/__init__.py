"""A token ring with unicast; `program.TokenRing` is the on-board program, `protocol.Ring` the protocol."""
