"""Co-design study of ranging, localisation and formation control; generates docs/codesign-results.md."""
