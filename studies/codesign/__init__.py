"""Co-design study: how ranging, localisation and formation control depend on each other.

Import `cli`, which makes docs/results/codesign-results.md: `cases` and `flights` fly, `estimator_section` and
`factor_sections` evaluate. Flights are left to `harness.launch`, runner and report to `studies.common`.
"""
