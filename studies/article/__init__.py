"""Reproduction of the article: its statements compared with our flights.

Import `cli`, which makes docs/results/article.md: `plan` flies the cases, `*_findings` judge the statements,
`page` writes the report. Flights are left to `harness.campaign`, runner and report to `studies.common`.
"""
