"""Studies that generate the report pages: validations, benchmarks, the co-design study and the article.

Each folder is one study; `common` holds the shared parts, `reference` the results of others. No package
imports a study: the `coflight` command loads one by name when it is called.
"""
