"""Texts of the pages of docs/reference, which `scripts/write_reference.py` writes.

Code without a docstring that a page needs is an `UndocumentedError`.
"""
