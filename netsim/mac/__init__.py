"""Channel access and frame exchange; propagation and reception are in `netsim.phy`."""
