"""Reproduction of the article: its statements compared with our flights; generates docs/article.md."""
