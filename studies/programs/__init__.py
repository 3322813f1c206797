"""Unmodified programs on the emulated channel: iperf3, ping and babeld, measured against the channel itself.

Import `cli`. Each section flies with programs in the vehicles' network namespaces and judges what they
report. `radio_models` and `closing_line` are named by the scenarios. The namespaces are left to
`netsim.network`.
"""
