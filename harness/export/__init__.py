"""A run as one MCAP file for Foxglove and PlotJuggler.

Import `run_export.write_mcap`. The other modules are pure mappings from records to messages; only `mcap_file`
imports mcap and protobuf. Records are read by `harness.records.pieces`.
"""
