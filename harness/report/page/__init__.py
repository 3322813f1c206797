"""``report.html``: the results of a run as one file that a browser opens from disk, without a network.

Import `run_page.write_page`. `encoding`, `envelope`, `channel_plots`, `flight_plots`, `replay`, `timeline`,
`scenario_changes` are pure: they turn arrays and results into figures and tables. `run_tables` reads the
Parquet tables by columns; `html` alone imports Jinja and Plotly. The page of a campaign is made by
`harness.campaign.page`.
"""
