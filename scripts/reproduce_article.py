"""The article's results flown again: ``python scripts/reproduce_article.py``. See docs/results/article.md."""

import os

from harness.launch import kernel_cache

os.environ.update(kernel_cache.environment())  # read when numba is imported, which is next

from studies.article.cli import article_app

if __name__ == "__main__":
    article_app()
