"""Co-design study of ranging, localisation and formation control: makes docs/results/codesign-results.md."""
