"""The live view and the replay of a run in the viewer Rerun, from the run's records.

Import `live_view.LiveView` and `feed.replay`. `scene` maps records to what is shown, without a viewer;
`rerun_sink` alone imports Rerun. The records are read by `harness.records`.
"""
