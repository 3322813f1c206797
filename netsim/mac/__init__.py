"""Medium access: contention for the channel, frame exchanges, retries, rates, interferers.

`contention` has backoff and queues, `access_parameters` the constants of DCF and EDCA, `station` the frame
exchanges, `loop` the compiled event loop, `radios` its interface. Propagation and reception are in
`netsim.phy`.
"""
