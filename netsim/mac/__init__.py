"""Channel access (when) and frame exchange (which sequence); what survives is `netsim.phy`'s."""
