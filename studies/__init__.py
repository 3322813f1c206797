"""Studies that generate the report pages: validations, benchmarks, the co-design study and the article.

Each folder is one study with its own command line; `common` holds the shared parts. No package of coflight
imports a study, and flights do not need them.
"""
