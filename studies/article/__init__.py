"""Reproduction of the article: its statements compared with our flights (docs/results/article.md)."""
