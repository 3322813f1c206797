"""The article's results flown again: its statements, each beside what came out."""
